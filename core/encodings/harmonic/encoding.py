"""The harmonic encoding: one radial basis for the map, harmonics in azimuth."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from core.encodings.base import PAPER_RANKS, Encoding
from core.encodings.basis import Basis
from core.encodings.distance import Distance
from core.encodings.grams import fit_radial_basis
from core.encodings.harmonic.basis import HarmonicBasis
from core.encodings.harmonic.codes import SignatureCodes
from core.encodings.harmonic.fit import fit, model_of
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.numbers import SignatureNumbers
from core.encodings.harmonic.packing import LAYOUTS, pack, unpack
from core.encodings.harmonic.place_index import HarmonicPlaceIndex
from core.encodings.harmonic.rank_sweep import rank_sweep
from core.encodings.harmonic.stored import StoredSignatures
from core.encodings.harmonics import (
    harmonic_elements,
    kept_ranks,
    weights,
)
from core.encodings.model import Model
from core.encodings.signature import Packing, Signature
from core.errors import InvalidMap, InvalidParameters, InvalidSignature
from core.progress import Progress
from core.projection.imager import LATERAL_RENDERINGS_M, ImageKind, Views
from core.projection.images import ImageSource
from core.projection.reducer import Reducer
from core.projection.visibility import SECTORS, View
from core.scans.trajectory import Trajectory

if TYPE_CHECKING:
    from core.parameters import MapParameters

_CODES, _SCALES = "signature_codes", "rendering_scales"
_HIDDEN = "hidden_sectors"
_IMAGES = "verification_images"
_RANKS_OF_ANY_VIEWS = (6, 7)  # 78 numbers: a partial view is 99 bytes


class HarmonicEncoding(Encoding):
    """G = U^T S F: answers in any heading and lane (docs/decisions/0010-harmonic-encoding.md)."""

    name = "harmonic"
    reducers: ClassVar = {ImageKind.HEIGHT: Reducer.HIGHEST, ImageKind.RANGE: Reducer.MEAN}
    wraps = True
    distance = Distance.NORMALISED
    lateral_renderings_m = LATERAL_RENDERINGS_M
    dtypes: ClassVar = {
        "radial_basis": "<f4",
        _CODES: "|i1",
        _SCALES: "<f4",
        "lateral_offset_m": "<f8",
    }
    layouts: ClassVar = LAYOUTS
    packings = (Packing.INT8, Packing.FLOAT16)
    signature_dtype = np.dtype(np.complex64)
    fits_to_grams = True
    masks = True
    yaw_invariant = True
    sharper = 1.4

    def default_views(self, image: ImageKind, distance: Distance | None) -> Views:
        """Return any of heights, compared by the normalised distance."""
        whole = image != ImageKind.HEIGHT or distance != Distance.NORMALISED
        return Views.FULL if whole else Views.ANY

    def default_ranks(self, views: Views) -> tuple[int, int]:
        """Return more for any views: docs/decisions/0030-any-view.md."""
        return PAPER_RANKS if views == Views.FULL else _RANKS_OF_ANY_VIEWS

    def largest_ranks(self, grid_shape: tuple[int, int]) -> tuple[int, int]:
        """Return I and how many harmonics J columns have."""
        rows, columns = grid_shape
        return rows, columns // 2 + 1

    def require_any_views(self, parameters: "MapParameters") -> None:
        """Reject range images, whose heights are not known, and the plain distance."""
        if parameters.image != ImageKind.HEIGHT or parameters.distance != Distance.NORMALISED:
            raise InvalidParameters(
                f"views is {parameters.views}, which wants height images and the normalised"
                f" distance; they are {parameters.image} and {parameters.distance}"
            )

    def kept_ranks(self, parameters: "MapParameters") -> tuple[int, int]:
        """Return those that are sent or, for any views, more."""
        return kept_ranks(parameters)

    def require_shape(self, shape: tuple[int, ...], parameters: "MapParameters") -> None:
        """Reject values of other ranks or, in a map of any views, of higher ones than it keeps."""
        if parameters.views == Views.FULL:
            super().require_shape(shape, parameters)
            return
        if shape == parameters.ranks:
            return
        r1, r2 = self.kept_ranks(parameters)
        if shape[0] > r1 or shape[1] > r2:
            raise InvalidSignature(
                f"the signature has shape {shape}, wanted r1 up to {r1} and r2 up to {r2}"
            )

    def elements(self, parameters: "MapParameters", segments: int, scans: int) -> int:
        """Return I r1 + D + K D r1 (2 r2 - 1), r1 and r2 being those that are kept."""
        renderings, rows = len(parameters.lateral_renderings_m or ()), parameters.grid.rows
        return harmonic_elements(scans, renderings, rows, self.kept_ranks(parameters))

    def stored_bytes(self, parameters: "MapParameters", segments: int, scans: int) -> int:
        """Return the size of U, viewpoints, codes, scales, and what partial views are compared by.

        A number is a byte, with a scale of four a rendering.
        """
        renderings, rows = len(parameters.lateral_renderings_m or ()), parameters.grid.rows
        r1, r2 = self.kept_ranks(parameters)
        of_rendering = r1 * (2 * r2 - 1) + 4 + 8 * (parameters.views == Views.ANY)
        of_image = rows * SECTORS * parameters.verification_images
        return 4 * rows * r1 + 8 * renderings + scans * (renderings * of_rendering + of_image)

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
        """Fit one radial basis to all renderings of all scans unless it is kept; encode them."""
        return fit(images, trajectory, segment_start, parameters, progress, kept, grams)

    def place_index(self) -> type[HarmonicPlaceIndex]:
        """Return the index whose places are ranked with all waves in phase."""
        return HarmonicPlaceIndex

    def basis_of_grams(
        self, grams: Mapping[str, FloatArray], parameters: "MapParameters"
    ) -> HarmonicBasis:
        """Return the basis of U fitted to these sums."""
        u = fit_radial_basis(grams, kept_ranks(parameters)[0])
        return HarmonicBasis.of(parameters, u)

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
        """Return the same for all cuts: the basis is shared."""
        return rank_sweep(images, queries, cuts, ranks, parameters, progress, counted)

    def arrays_of(self, attributes: Mapping[str, Any], *, coded: bool = True) -> Mapping[str, str]:
        """Return them, with numbers instead of codes, and with those of any views."""
        dtypes = dict(self.dtypes)
        if not coded:
            del dtypes[_CODES], dtypes[_SCALES]
            dtypes["signatures"] = "<c8"
        if attributes.get("views") != Views.ANY:
            return dtypes
        images = {_IMAGES: "|u1"} if attributes.get(_IMAGES) is True else {}
        return {**dtypes, _HIDDEN: "<i8", **images}

    def read_model(self, parameters: "MapParameters", arrays: Mapping[str, NDArray[Any]]) -> Model:
        """Return the model of these arrays."""
        stored: StoredSignatures
        if _CODES in arrays:
            stored = SignatureCodes(arrays[_CODES], arrays[_SCALES])
        else:
            stored = SignatureNumbers(arrays["signatures"])
        return model_of(
            arrays["radial_basis"],
            stored,
            arrays["lateral_offset_m"],
            arrays["segment_start"],
            parameters,
            None if parameters.views == Views.FULL else arrays[_HIDDEN],
            arrays[_IMAGES] if parameters.verification_images else None,
        )

    def require_model(self, model: Model, parameters: "MapParameters") -> None:
        """Reject a model of another measure, or of other viewpoints, too."""
        super().require_model(model, parameters)
        if not isinstance(model, HarmonicModel) or model.measure != parameters.distance:
            raise InvalidMap("the model's distance is not that of the parameters")
        if parameters.verification_images != (model.verification_images is not None):
            raise InvalidMap("the model has no verification images, or should have none")
        if model.sent_ranks != parameters.ranks:
            raise InvalidMap(f"queries are {model.sent_ranks}, by the ranks {parameters.ranks}")
        offsets = tuple(model.lateral_offset_m.tolist())
        if offsets != parameters.lateral_renderings_m:
            raise InvalidMap(f"lateral_offset_m is {offsets}, not that of the parameters")

    def read_basis(
        self, revision: str, digest: str, parameters: "MapParameters", values: Mapping[str, Any]
    ) -> HarmonicBasis:
        """Return the basis of these values."""
        u = np.array(values["radial_basis"], dtype=np.float32)
        return HarmonicBasis(revision, digest, parameters, u)

    def require_values(self, values: NDArray[Any]) -> None:
        """Reject a first column that is not real: it is the mean over azimuth."""
        if values[:, 0].imag.any():
            raise InvalidSignature("the first column of a harmonic signature is real")

    def weighted(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values whose plain inner product counts each harmonic for its conjugate too."""
        harmonics = values.shape[-1]
        # On more columns than any harmonic has, all but the first have a conjugate.
        return values.astype(np.complex128) * np.sqrt(weights(2 * harmonics, harmonics))

    def pack(self, signatures: Sequence[Signature], packing: Packing) -> tuple[int, bytes]:
        """Return the layout and the bytes of the one signature of a scan."""
        if len(signatures) > 1:
            raise InvalidSignature("a harmonic signature is packed alone")
        return pack(signatures[0], packing)

    def unpack(
        self, layout: int, body: bytes, shape: tuple[int, int], revision: str
    ) -> tuple[Signature, ...]:
        """Read what `pack` returned."""
        return (unpack(layout, body, shape, revision),)

    def as_values(self, signature: Signature) -> dict[str, Any]:
        """Return `values_real` and `values_imag`, r1 rows of r2 numbers each.

        And `hidden` and `rings` of a partial view.
        """
        values = signature.values
        parts = {"values_real": values.real.tolist(), "values_imag": values.imag.tolist()}
        if signature.view.hidden:
            parts["hidden"] = list(signature.view.hidden)
        return parts if signature.view.rings is None else parts | {"rings": signature.view.rings}

    def from_values(self, values: Mapping[str, Any], revision: str) -> Signature:
        """Return the signature of these parts.

        Raises:
            InvalidSignature: If they are of two shapes or a number is beyond float32.
        """
        real, imag = values["values_real"], values["values_imag"]
        lengths = {len(row) for row in (*real, *imag)}
        if len(lengths) != 1 or len(real) != len(imag):
            raise InvalidSignature("values_real and values_imag are not of one shape r1 x r2")
        found = np.zeros((len(real), lengths.pop()), np.complex64)
        with np.errstate(over="ignore"):  # infinite then, and rejected as not finite
            found.real, found.imag = real, imag
        view = View(tuple(values.get("hidden", ())), values.get("rings"))
        return Signature(found, None, revision, view=view)


ENCODING = HarmonicEncoding()
