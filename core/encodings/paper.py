"""The paper's encoding: each segment has bases of its own (paper, sec. 2.2 and 2.3)."""

from dataclasses import dataclass

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray, frozen
from core.errors import InvalidMap, UnknownSegment

__all__ = ["PaperModel", "SegmentModel"]


@dataclass(frozen=True, eq=False)
class SegmentModel:
    """One segment's Tucker2 model, `X ~ signatures x1 u x2 v`.

    Attributes:
        u: `(I, r1)`, orthonormal columns; the elevation basis.
        v: `(J, r2)`, orthonormal columns; the azimuth basis.
        signatures: `(k, r1, r2)`, the core tensor; slice `i` is the signature of scan `i`.
        first_scan: Row in the whole map of the segment's scan 0.
    """

    u: FloatArray
    v: FloatArray
    signatures: FloatArray
    first_scan: int


@dataclass(frozen=True, eq=False)
class PaperModel:
    """All segments' models, packed.

    Attributes:
        elevation_basis: `(L, I, r1)` float32.
        azimuth_basis: `(L, J, r2)` float32.
        signatures: `(K, r1, r2)` float32.
        segment_start: `(L + 1,)` row of each segment's first scan, and K.
    """

    elevation_basis: Float32Array
    azimuth_basis: Float32Array
    signatures: Float32Array
    segment_start: IntArray

    def __post_init__(self) -> None:
        for name in ("elevation_basis", "azimuth_basis", "signatures"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.float32))
        object.__setattr__(self, "segment_start", frozen(self.segment_start, np.int64))
        starts = self.segment_start
        if starts.ndim != 1 or len(starts) < 2 or starts[0] != 0 or (np.diff(starts) < 1).any():
            raise InvalidMap("segment_start does not rise from 0 through every segment")
        if any(a.ndim != 3 for a in (self.elevation_basis, self.azimuth_basis, self.signatures)):
            raise InvalidMap("bases and signatures have three axes each")
        segments, (scans, r1, r2) = len(starts) - 1, self.signatures.shape
        if (
            starts[-1] != scans
            or self.elevation_basis.shape[::2] != (segments, r1)
            or self.azimuth_basis.shape[::2] != (segments, r2)
        ):
            raise InvalidMap(
                f"elevation_basis {self.elevation_basis.shape}, azimuth_basis"
                f" {self.azimuth_basis.shape}, signatures {self.signatures.shape} and"
                f" segment_start {starts.shape} do not fit together"
            )
        for name in ("elevation_basis", "azimuth_basis", "signatures"):
            if not np.isfinite(getattr(self, name)).all():
                raise InvalidMap(f"{name} holds numbers that are not finite")

    @property
    def segments(self) -> int:
        """L, how many segments there are."""
        return len(self.segment_start) - 1

    @property
    def ranks(self) -> tuple[int, int]:
        """`(r1, r2)`, the shape of a signature."""
        return self.signatures.shape[1], self.signatures.shape[2]

    @property
    def grid_shape(self) -> tuple[int, int]:
        """`(I, J)`, the shape of an image."""
        return self.elevation_basis.shape[1], self.azimuth_basis.shape[1]

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

    def distances(self, signatures: FloatArray, segments: IntArray) -> tuple[IntArray, FloatArray]:
        """Return the rows of the segments' scans, `(n,)`, and their Frobenius distances, `(n,)`.

        Args:
            signatures: `(S, r1, r2)`, one in the bases of each segment.
            segments: `(S,)`; only the scans of these segments are compared.
        """
        self.require_segments(segments)
        starts, lengths = self.segment_start[segments], np.diff(self.segment_start)[segments]
        before = np.cumsum(lengths) - lengths
        rows = np.arange(lengths.sum()) + np.repeat(starts - before, lengths)
        difference = self.signatures[rows] - np.repeat(signatures, lengths, axis=0)
        squared = np.einsum("nij,nij->n", difference, difference)
        return rows, np.sqrt(squared)

    def segment(self, index: int) -> SegmentModel:
        """Return one segment's model.

        Raises:
            UnknownSegment: If the map has no such segment.
        """
        self.require_segments(np.array([index]))
        start, end = self.segment_start[index : index + 2]
        return SegmentModel(
            self.elevation_basis[index].astype(np.float64),
            self.azimuth_basis[index].astype(np.float64),
            self.signatures[start:end].astype(np.float64),
            int(start),
        )
