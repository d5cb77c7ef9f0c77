"""The interface of an encoding: from images to signatures, bases and a map's model."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from core.encodings.basis import Basis
from core.encodings.distance import Distance
from core.encodings.model import Model
from core.encodings.signature import Packing, Signature
from core.encodings.tucker import row_gram
from core.errors import InvalidMap, InvalidParameters, InvalidSignature
from core.progress import Progress
from core.projection.imager import ImageKind, Views
from core.projection.images import ImageSource
from core.projection.reducer import Reducer
from core.scans.trajectory import Trajectory

if TYPE_CHECKING:
    from core.encodings.place_index import PlaceIndex
    from core.parameters import MapParameters

PAPER_RANKS = (5, 5)
"""The paper's, `(r1, r2)`."""


class Encoding(ABC):
    """Encodes images as signatures and searches signatures. It has no state.

    One instance is registered under its name (`core.encodings.registry`); code outside of
    `core.encodings` uses this interface and does not check which encoding it has.

    Attributes:
        name: The name in parameters, in files and on the wire.
        reducers: The default reducer of each kind of image that it encodes, its default kind first.
        wraps: Whether the last column of an image must be next to the first.
        distance: The default of that parameter, `None` if it has one measure only.
        lateral_renderings_m: The default viewpoints of renderings, `None` without renderings.
        implied_by: Reducers that select this encoding where none is named.
        dtypes: The dtypes of its own arrays in every map file, by name, without `segment_start`.
        layouts: Names of its layouts of packed signatures.
        packings: How its signatures can be packed, the default first.
        signature_dtype: The dtype of a signature's values.
        per_segment: Whether a signature is made with the bases of one segment.
        shares_basis: Whether all segments share one basis, which other drives' maps can keep.
        fits_to_grams: Whether it is fitted to the detail in each drive's images (`drive_gram`).
        masks: Whether a signature can say which sectors are hidden from its scan.
        yaw_invariant: Whether a scan matches at any relative yaw of the query.
        sharper: How much sharper the scans of one drive are separated than a calibration's probes,
            which are disturbed in several ways at once. Measured on simulated cities.
    """

    name: ClassVar[str]
    reducers: ClassVar[Mapping[ImageKind, Reducer]]
    wraps: ClassVar[bool] = False
    distance: ClassVar[Distance | None] = None
    lateral_renderings_m: ClassVar[tuple[float, ...] | None] = None
    implied_by: ClassVar[frozenset[Reducer]] = frozenset()
    dtypes: ClassVar[Mapping[str, str]]
    layouts: ClassVar[Mapping[int, str]]
    packings: ClassVar[tuple[Packing, ...]] = (Packing.FLOAT16,)
    signature_dtype: ClassVar[np.dtype[Any]] = np.dtype(np.float32)
    per_segment: ClassVar[bool] = False
    shares_basis: ClassVar[bool] = True
    fits_to_grams: ClassVar[bool] = False
    masks: ClassVar[bool] = False
    yaw_invariant: ClassVar[bool] = False
    sharper: ClassVar[float] = 1.0

    # --- Parameters

    def default_reducer(self, image: ImageKind) -> Reducer:
        """Return the reducer of a kind of image where none is named.

        Raises:
            InvalidParameters: If this encoding does not encode such images.
        """
        if image not in self.reducers:
            raise InvalidParameters(
                f"the {self.name} encoding encodes {', '.join(self.reducers)} images,"
                f" not {image} images"
            )
        return self.reducers[image]

    def default_views(self, image: ImageKind, distance: Distance | None) -> Views:
        """Return which views a map of such images answers where none are named."""
        del image, distance
        return Views.FULL

    def default_ranks(self, views: Views) -> tuple[int, int]:
        """Return the ranks where none are named: the paper's."""
        del views
        return PAPER_RANKS

    def largest_ranks(self, grid_shape: tuple[int, int]) -> tuple[int, int]:
        """Return the largest `(r1, r2)` on a grid of `(I, J)` cells."""
        return grid_shape

    def require_parameters(self, parameters: "MapParameters") -> None:
        """Check parameters.

        Raises:
            InvalidParameters: If the image, the grid, the ranks, or a parameter that only some
                encodings have is not valid in this encoding.
        """
        self.default_reducer(parameters.image)
        if self.wraps and not parameters.grid.wraps:
            raise InvalidParameters(
                f"a {self.name} map's grid wraps: relative yaw must not have a seam"
            )
        if parameters.views != Views.FULL:
            self.require_any_views(parameters)
        elif parameters.verification_images:
            raise InvalidParameters("verification_images is true, which wants views = any")
        for name in ("distance", "lateral_renderings_m"):
            default, given = getattr(self, name), getattr(parameters, name)
            if default is None and given is not None:
                raise InvalidParameters(f"{name} is no parameter of the {self.name} encoding")
            if default is not None and given is None:
                raise InvalidParameters(f"a {self.name} map needs {name}")
        most = self.largest_ranks(parameters.grid.shape)
        for rank, size, name in zip(parameters.ranks, most, ("r1", "r2"), strict=True):
            if not 1 <= rank <= size:
                raise InvalidParameters(f"{name} is {rank}, wanted 1..{size} on this grid")

    def kept_ranks(self, parameters: "MapParameters") -> tuple[int, int]:
        """Return the shape of a map's signatures: what queries can be compared with."""
        return parameters.ranks

    def require_shape(self, shape: tuple[int, ...], parameters: "MapParameters") -> None:
        """Raise `InvalidSignature` unless a query's values may have this shape."""
        if shape != parameters.ranks:
            raise InvalidSignature(
                f"the signature has shape {shape}, this map's have {parameters.ranks}"
            )

    def require_any_views(self, parameters: "MapParameters") -> None:
        """Raise `InvalidParameters` unless partial views can be compared in a map of these."""
        raise InvalidParameters(
            f"views is {parameters.views}; the {self.name} encoding compares full views only"
        )

    @abstractmethod
    def elements(self, parameters: "MapParameters", segments: int, scans: int) -> int:
        """Return how many numbers the bases and signatures of a map are (paper, sec. 2.4)."""

    def stored_bytes(self, parameters: "MapParameters", segments: int, scans: int) -> int:
        """Return the size of the arrays of a new map, without those that every map has.

        By default that of `elements` in float32.
        """
        return 4 * self.elements(parameters, segments, scans)

    # --- Images to a model

    @abstractmethod
    def fit(
        self,
        images: ImageSource,
        trajectory: Trajectory,
        segment_start: IntArray,
        parameters: "MapParameters",
        progress: Progress,
        kept: Basis | None = None,
        grams: Mapping[str, FloatArray] | None = None,
    ) -> tuple[Model, FloatArray]:
        """Fit the bases and encode every scan.

        The result depends only on the images and the cuts: each segment is summed in blocks that
        begin at its first scan, and segments in their order.

        Args:
            images: One image a scan of the trajectory, on the parameters' grid.
            trajectory: The drive of each scan.
            segment_start: `(L + 1,)` rows where segments begin, and K.
            parameters: Ranks and all that queries must share with the map.
            progress: Receives every image of each pass.
            kept: A basis that `serves` these parameters, to keep instead of fitting one.
            grams: The result of `drive_gram` for every drive, by name, if known.

        Returns:
            The model, and `(L,)` |X - X^| / |X| of each segment's images.

        Raises:
            InvalidParameters: If the basis or the sums do not fit the parameters or drives.
            InvalidImage: If the source returns images of another number or shape.
        """

    def basis_of_grams(self, grams: Mapping[str, FloatArray], parameters: "MapParameters") -> Basis:
        """Return the basis that is fitted to the sums of some drives, of no map.

        Args:
            grams: The result of `drive_gram` for every drive, by name.
            parameters: The parameters of the maps that will use it.

        Raises:
            InvalidParameters: If this encoding does not fit its basis to such sums.
        """
        raise InvalidParameters(f"a basis of the {self.name} encoding is fitted to no sums")

    def place_index(self) -> "type[PlaceIndex[Any]] | None":
        """Return how places of many maps of one basis are indexed, `None` if they are not."""
        return None

    def explaining_grams(self, images: Float32Array) -> tuple[FloatArray, ...]:
        """Return `(n, I, J)` images' Gram matrix for each mode that a segment's model has.

        Unequal segments grow while that model explains them. By default the row space, which
        relative yaw does not change.
        """
        return (row_gram(np.maximum(images, 0.0)),)

    def rank_sweep(
        self,
        images: ImageSource,
        queries: Float32Array,
        cuts: Sequence[IntArray],
        ranks: tuple[Sequence[int], Sequence[int]],
        parameters: "MapParameters",
        progress: Progress,
        counted: BoolArray,
    ) -> tuple[IntArray, FloatArray]:
        """Return the nearest scan of every query in maps of all ranks and cuts.

        Args:
            images: The images of the mapped scans.
            queries: `(n, I, J)`.
            cuts: Segment starts of each map.
            ranks: Rising r1 and rising r2.
            parameters: The parameters of the maps, except their ranks.
            progress: Receives every image, and every scan of each map.
            counted: `(K,)` which scans count for a basis of all, see `first_of_stands`.

        Returns:
            Rows `(len(cuts), n, len(r1), len(r2))`, and relative errors without the axis of `n`.

        Raises:
            InvalidParameters: If this encoding has no sweep.
        """
        raise InvalidParameters(f"ranks of the {self.name} encoding cannot be swept")

    # --- Files and wire

    def arrays_of(self, attributes: Mapping[str, Any], *, coded: bool = True) -> Mapping[str, str]:
        """Return the dtype of each own array in the file of a map of these attributes.

        Args:
            attributes: The map's attributes.
            coded: Whether signatures are codes, in an encoding that has them.
        """
        del attributes, coded
        return self.dtypes

    @abstractmethod
    def read_model(self, parameters: "MapParameters", arrays: Mapping[str, NDArray[Any]]) -> Model:
        """Return the model of the arrays that `Model.arrays` returned.

        Raises:
            InvalidMap: If the arrays do not fit together.
            KeyError: If one is missing.
        """

    def require_model(self, model: Model, parameters: "MapParameters") -> None:
        """Raise `InvalidMap` unless the model is of this encoding and these parameters."""
        if model.encoding != self.name:
            raise InvalidMap(f"the model is not of the encoding {self.name}")
        kept = self.kept_ranks(parameters)
        if model.ranks != kept:
            raise InvalidMap(f"signatures are {model.ranks}, by the ranks {kept} are wanted")
        if model.grid_shape != parameters.grid.shape:
            raise InvalidMap(f"bases are for {model.grid_shape}, not for the grid")

    @abstractmethod
    def read_basis(
        self, revision: str, digest: str, parameters: "MapParameters", values: Mapping[str, Any]
    ) -> Basis:
        """Return the basis of values that `Basis.as_values` returned.

        Raises:
            InvalidMap: If the parameters or the digest are others.
        """

    def require_values(self, values: NDArray[Any]) -> None:
        """Raise `InvalidSignature` unless these `(r1, r2)` finite values can be a signature."""
        del values

    def weighted(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return `(..., r1, r2)` values with the inner product of signatures as plain product."""
        return values.astype(np.float64)

    @abstractmethod
    def pack(self, signatures: Sequence[Signature], packing: Packing) -> tuple[int, bytes]:
        """Return the layout, and the bytes that follow the header.

        Raises:
            InvalidSignature: If they cannot be packed that way.
        """

    @abstractmethod
    def unpack(
        self, layout: int, body: bytes, shape: tuple[int, int], revision: str
    ) -> tuple[Signature, ...]:
        """Return the signatures of packed bytes.

        Raises:
            InvalidSignature: If the bytes are not of that layout.
        """

    @abstractmethod
    def as_values(self, signature: Signature) -> dict[str, Any]:
        """Return one signature as plain values, its revision left out.

        Encodings that are not shipped put their name under `encoding`.
        """

    @abstractmethod
    def from_values(self, values: Mapping[str, Any], revision: str) -> Signature:
        """Return the signature of values that `as_values` returned.

        Raises:
            InvalidSignature: If they are no signature.
        """
