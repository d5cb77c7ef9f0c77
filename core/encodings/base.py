"""What every encoding gives: its arrays, and a search through its scans."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from core.arrays import BoolArray, FloatArray, IntArray
from core.encodings.signature import Signature
from core.errors import InvalidMap, UnknownSegment

__all__ = ["Found", "Model", "Search", "Segmented", "nearest", "require_sane"]

_LARGEST_SIGNATURE = 1e12  # sums of squares stay finite in single precision too
_LARGEST_OF_BASIS = 1.001  # its columns have length 1


@dataclass(frozen=True)
class Found:
    """A scan of the map, and how a query lies to it.

    Attributes:
        row: Its row in the map.
        distance: Between the signatures.
        turn_deg: How far the query is turned from it, counter-clockwise, -180..180; `None` where
            the encoding does not tell.
        lateral_m: How far to the left of it the query stands, `None` likewise.
    """

    row: int
    distance: float
    turn_deg: float | None = None
    lateral_m: float | None = None


class Search(Protocol):
    """One query, ready to be compared with the scans of a map."""

    @property
    def segments(self) -> tuple[int, ...]:
        """The segments that are searched, rising."""

    def nearest(self, k: int, among: BoolArray | None = None) -> tuple[Found, ...]:
        """Return the `k` nearest scans, nearest first, at most as many as there are.

        Args:
            k: At least 1.
            among: `(K,)` which rows of the map come into question; all of them without it.
        """

    def distances(self, among: BoolArray | None = None) -> FloatArray:
        """Return the exact distance of each scan, `(K,)`, that of its nearest rendering.

        Infinite where a scan was not asked for, or is not compared by this query.

        Args:
            among: `(K,)` which rows are asked for; all of them without it.
        """


class Model(Protocol):
    """The bases and signatures of a map in one encoding."""

    @property
    def segment_start(self) -> IntArray:
        """`(L + 1,)` row of each segment's first scan, and K."""

    @property
    def segments(self) -> int:
        """L, how many segments there are."""

    @property
    def segment_of_scan(self) -> IntArray:
        """The segment of each scan, `(K,)`."""

    @property
    def ranks(self) -> tuple[int, int]:
        """`(r1, r2)`, the shape of a signature."""

    @property
    def grid_shape(self) -> tuple[int, int]:
        """`(I, J)`, the shape of an image."""

    @property
    def elements(self) -> int:
        """How many numbers the bases and signatures are."""

    def __len__(self) -> int:
        """Return K, how many scans there are."""

    def require_segments(self, segments: IntArray) -> None:
        """Raise `UnknownSegment` unless the map has every one of `segments`."""

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name in the file."""

    def search(self, signatures: Sequence[Signature]) -> Search:
        """Compare one scan's signatures with the map's.

        Raises:
            InvalidSignature: If they are of another encoding or do not belong together.
            UnknownSegment: If one is of a segment that the map does not have.
        """


class Segmented:
    """Scans in order, cut into segments."""

    segment_start: IntArray

    def _require_rising(self, scans: int) -> None:
        starts = self.segment_start
        if starts.ndim != 1 or len(starts) < 2 or starts[0] != 0 or (np.diff(starts) < 1).any():
            raise InvalidMap("segment_start does not rise from 0 through every segment")
        if starts[-1] != scans:
            raise InvalidMap(f"segment_start ends at {starts[-1]}, there are {scans} signatures")

    def __len__(self) -> int:
        return int(self.segment_start[-1])

    @property
    def segments(self) -> int:
        """L, how many segments there are."""
        return len(self.segment_start) - 1

    @property
    def segment_of_scan(self) -> IntArray:
        """The segment of each scan, `(K,)`."""
        return np.repeat(np.arange(self.segments), np.diff(self.segment_start))

    def require_segments(self, segments: IntArray) -> None:
        """Raise `UnknownSegment` unless the map has every one of `segments`."""
        unknown = segments[(segments < 0) | (segments >= self.segments)]
        if len(unknown):
            raise UnknownSegment(
                f"there is no segment {unknown[0]}; the map has 0..{self.segments - 1}"
            )


def require_sane(bases: Mapping[str, NDArray[Any]], signatures: NDArray[Any]) -> None:
    """Refuse numbers that no build makes, and with which no distance is finite.

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


def nearest(distances: FloatArray, k: int) -> IntArray:
    """Return the indices of the `k` smallest, nearest first, earlier ones first among equals."""
    if k >= len(distances):
        return np.argsort(distances, kind="stable")
    bound = np.partition(distances, k - 1)[k - 1]
    candidates = np.flatnonzero(distances <= bound)
    return candidates[np.argsort(distances[candidates], kind="stable")][:k]
