"""The bases and signatures of a map."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from core.arrays import IntArray, arrays_of, frozen
from core.encodings.basis import Basis
from core.encodings.search import QueryLimits, Search
from core.encodings.signature import Signature
from core.errors import InvalidMap, UnknownSegment
from core.projection.imager import Image
from core.projection.visibility import FULL_VIEW, View

if TYPE_CHECKING:
    from core.parameters import MapParameters

_LARGEST_SIGNATURE = 1e12  # sums of squares stay finite in single precision too
_LARGEST_OF_BASIS = 1.001  # its columns have length 1
_SKEWED = 1e-3  # a product of two columns; rounding to single precision is 1e-6


class Model(ABC):
    """The bases and signatures of a map in one encoding: scans in order, cut into segments.

    Attributes:
        encoding: The encoding's name.
        signatures: `(K, ...)` of every scan.
        segment_start: `(L + 1,)` row of each segment's first scan, and K.
    """

    encoding: ClassVar[str]
    segment_start: IntArray

    if TYPE_CHECKING:  # a field of some models, computed by others

        @property
        def signatures(self) -> NDArray[Any]:
            """All of them."""

    def __len__(self) -> int:
        return int(self.segment_start[-1])

    @property
    def segments(self) -> int:
        """L, how many segments there are."""
        return len(self.segment_start) - 1

    @cached_property
    def segment_of_scan(self) -> IntArray:
        """The segment of each scan, `(K,)`."""
        segments = np.arange(self.segments)
        return frozen(np.repeat(segments, np.diff(self.segment_start)), np.int64)

    @property
    @abstractmethod
    def ranks(self) -> tuple[int, int]:
        """`(r1, r2)`, the shape of a signature."""

    @property
    @abstractmethod
    def grid_shape(self) -> tuple[int, int]:
        """`(I, J)`, the shape of an image."""

    @property
    def bases(self) -> dict[str, NDArray[Any]]:
        """Its bases, `(..., n, r)`, by their names in a file; none in an encoding without them."""
        return {}

    def require_orthonormal(self) -> None:
        """Reject bases with which norms would not be those of images, as a foreign file may have.

        Raises:
            InvalidMap: If the columns of one are not orthonormal.
        """
        for name, basis in self.bases.items():
            products = basis.swapaxes(-1, -2) @ basis
            if (np.abs(products - np.eye(products.shape[-1])) > _SKEWED).any():
                raise InvalidMap(f"{name} has columns that are not orthonormal")

    @property
    def recorded(self) -> NDArray[Any]:
        """Signatures of the scans as they were recorded, `(K, r1, r2)`."""
        return self.signatures

    @property
    def recorded_lateral_m(self) -> float:
        """How far to the left of the recorded line the viewpoint of `recorded` is."""
        return 0.0

    @property
    def gives_relative_yaw(self) -> bool:
        """Whether a match has a relative yaw."""
        return False

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name in the file."""
        return arrays_of(self)

    @abstractmethod
    def search(self, signatures: Sequence[Signature]) -> Search:
        """Compare one scan's signatures with the map's.

        Raises:
            InvalidSignature: If they are of another encoding or do not belong together.
            UnknownSegment: If one is of a segment that the map does not have.
        """

    @abstractmethod
    def search_values(self, values: NDArray[Any], view: View = FULL_VIEW) -> Search:
        """Compare an image that the basis of all segments projected, without checks.

        Args:
            values: The values as `Basis.project` returns them.
            view: What the image shows; full but in an encoding that masks.
        """

    def search_image(self, image: Image, basis: Basis) -> Search:
        """Compare an image, by all that the map has for that: at least by its signatures.

        Args:
            image: An image of the map's kind and grid.
            basis: The basis of all segments.

        Raises:
            SensorMismatch: If the image is of another kind or on another grid.
        """
        return self.search_values(basis.project(image), basis.view(image))

    @abstractmethod
    def own_queries(
        self, rows: Iterable[int], named: str, segments: IntArray | None = None
    ) -> Iterator[tuple[Signature, ...]]:
        """Yield for each row the signatures of a query at that scan, as far as the map gives them.

        Args:
            rows: Rows of the map.
            named: Digest of the basis or revision that the signatures name.
            segments: The segments in whose bases the queries are; all without it.
        """

    def search_own(
        self, row: int, limits: QueryLimits | None = None, turned: int = 0
    ) -> Search | None:
        """Return the search of a query at one of its scans, by the small image that it keeps of it.

        `None` of a map without such images, or if nothing is left of one within some limits, whose
        hidden sectors are `turned`.
        """
        return None

    @abstractmethod
    def basis_digests(self, parameters: "MapParameters") -> tuple[str, ...]:
        """Return the digests of the bases that this map has, 64 hexadecimal digits each."""

    @abstractmethod
    def basis(
        self, revision: str, digest: str, parameters: "MapParameters", segments: IntArray
    ) -> Basis:
        """Return the basis of some segments; in an encoding of one basis, that of all segments."""

    def limits_of(self, shape: tuple[int, ...], view: View) -> QueryLimits | None:
        """Return `Search.limits` of a signature of that shape; `None` in most encodings."""
        del shape, view
        return None

    def limited_query(
        self, row: int, named: str, limits: QueryLimits, turned: int
    ) -> Signature | None:
        """Return what `own_queries` yields of a scan, within some limits of `limits_of`.

        Encodings whose `limits_of` is always `None` do not have it.

        Args:
            row: The scan's.
            named: What the signature names.
            limits: Its numbers and view.
            turned: By how many sectors the hidden ones are turned.

        Returns:
            The signature, `None` if nothing of the scan is left.
        """
        raise NotImplementedError

    @abstractmethod
    def select(self, rows: IntArray, segments: IntArray, segment_start: IntArray) -> Self:
        """Return the model of some scans, all those of some segments, unchanged."""

    @abstractmethod
    def joined(self, others: Sequence[Self], segment_start: IntArray) -> Self:
        """Return one model of this one's scans and those of others after it."""

    def require_segments(self, segments: IntArray) -> None:
        """Raise `UnknownSegment` unless the map has every one of `segments`."""
        unknown = segments[(segments < 0) | (segments >= self.segments)]
        if len(unknown):
            raise UnknownSegment(
                f"there is no segment {unknown[0]}; the map has 0..{self.segments - 1}"
            )

    def _require_rising(self, scans: int) -> None:
        starts = self.segment_start
        if starts.ndim != 1 or len(starts) < 2 or starts[0] != 0 or (np.diff(starts) < 1).any():
            raise InvalidMap("segment_start does not rise from 0 through every segment")
        if starts[-1] != scans:
            raise InvalidMap(f"segment_start ends at {starts[-1]}, there are {scans} signatures")


def require_sane(bases: Mapping[str, NDArray[Any]], signatures: NDArray[Any]) -> None:
    """Reject numbers that no build computes, and with which no distance is finite.

    Raises:
        InvalidMap: If one is not finite or too large.
    """
    for name, array, most in (
        *((name, basis, _LARGEST_OF_BASIS) for name, basis in bases.items()),
        ("signatures", signatures, _LARGEST_SIGNATURE),
    ):
        # Parts, not magnitudes: those of complex numbers take ten times as long.
        parts = array.view(array.real.dtype)
        if not np.isfinite(parts).all():
            raise InvalidMap(f"{name} holds numbers that are not finite")
        if parts.size and max(-parts.min(), parts.max()) > most:
            raise InvalidMap(f"{name} holds numbers beyond {most:g}")
