"""Models of a map whose segments have bases of their own (paper, sec. 2.2 and 2.3)."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from core.arrays import Float32Array, FloatArray, IntArray, freeze
from core.encodings.model import Model, require_sane
from core.encodings.paper.basis import PaperBasis, paper_basis_digests
from core.encodings.search import DistanceSearch
from core.encodings.signature import Signature
from core.errors import InvalidMap, InvalidSignature
from core.projection.visibility import FULL_VIEW, View

if TYPE_CHECKING:
    from core.parameters import MapParameters


@dataclass(frozen=True, eq=False)
class PaperModel(Model):
    """The Tucker2 models of all segments, `X ~ signatures x1 u x2 v` in each.

    Attributes:
        elevation_basis: `(L, I, r1)` float32, U of each segment, orthonormal columns.
        azimuth_basis: `(L, J, r2)` float32, V of each segment, orthonormal columns.
        signatures: `(K, r1, r2)` float32, the slices of the core tensors.
        segment_start: `(L + 1,)` row of each segment's first scan, and K.
    """

    encoding: ClassVar[str] = "paper"

    elevation_basis: Float32Array
    azimuth_basis: Float32Array
    signatures: Float32Array
    segment_start: IntArray

    def __post_init__(self) -> None:
        freeze(self, elevation_basis=np.float32, azimuth_basis=np.float32)
        freeze(self, signatures=np.float32, segment_start=np.int64)
        if any(a.ndim != 3 for a in (self.elevation_basis, self.azimuth_basis, self.signatures)):
            raise InvalidMap("bases and signatures have three axes each")
        scans, r1, r2 = self.signatures.shape
        self._require_rising(scans)
        shapes = self.elevation_basis.shape[::2], self.azimuth_basis.shape[::2]
        if shapes != ((self.segments, r1), (self.segments, r2)):
            raise InvalidMap(
                f"elevation_basis {self.elevation_basis.shape}, azimuth_basis"
                f" {self.azimuth_basis.shape}, signatures {self.signatures.shape} and"
                f" segment_start {self.segment_start.shape} do not fit together"
            )
        require_sane(self.bases, self.signatures)

    def __repr__(self) -> str:  # without the arrays
        scans, segments, ranks = len(self), self.segments, self.ranks
        grid_shape = self.grid_shape
        return f"PaperModel({scans=}, {segments=}, {ranks=}, {grid_shape=})"

    @property
    def bases(self) -> dict[str, NDArray[Any]]:
        """Those of elevation and of azimuth, of each segment."""
        return {"elevation_basis": self.elevation_basis, "azimuth_basis": self.azimuth_basis}

    @property
    def ranks(self) -> tuple[int, int]:
        """`(r1, r2)`, the shape of a signature."""
        return self.signatures.shape[1], self.signatures.shape[2]

    @property
    def grid_shape(self) -> tuple[int, int]:
        """`(I, J)`, the shape of an image."""
        return self.elevation_basis.shape[1], self.azimuth_basis.shape[1]

    def search(self, signatures: Sequence[Signature]) -> "DistanceSearch":
        """Compare one scan's signatures with those of their segments.

        Raises:
            InvalidSignature: If a segment is repeated or a signature is harmonic.
            UnknownSegment: If the map has no such segment.
        """
        segments = [s.segment for s in signatures if s.segment is not None]
        if len(segments) < len(signatures):
            raise InvalidSignature(
                f"the signature is {signatures[0].encoding}, this map is of the paper's encoding"
            )
        if len(set(segments)) < len(segments):
            raise InvalidSignature(f"a segment is repeated in {segments}")
        order = np.argsort(segments)  # of equally near scans the earlier one is first
        values = np.stack([signatures[i].values for i in order]).astype(np.float64)
        rows, distances = self.distances(values, np.array(segments, dtype=np.int64)[order])
        return DistanceSearch(tuple(sorted(segments)), rows, distances, len(self))

    def search_values(self, values: NDArray[Any], view: View = FULL_VIEW) -> DistanceSearch:
        """Compare an image's values in the bases of all segments, `(L, r1, r2)`."""
        del view  # of such maps it is full
        segments = np.arange(self.segments)
        rows, distances = self.distances(values.astype(np.float64), segments)
        return DistanceSearch(tuple(segments.tolist()), rows, distances, len(self))

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
        squared = np.empty(len(rows))
        # Segment by segment: of a large map all differences at once would leave the cache.
        for values, start, at, count in zip(signatures, starts, before, lengths, strict=True):
            difference = self.signatures[start : start + count] - values
            np.einsum("nij,nij->n", difference, difference, out=squared[at : at + count])
        return rows, np.sqrt(squared)

    def own_queries(
        self, rows: Iterable[int], named: str, segments: IntArray | None = None
    ) -> Iterator[tuple[Signature, ...]]:
        """Yield each scan's signatures, of the segment's model of it: U_l^T U G V^T V_l.

        They lack the part of the image that the bases of its own segment leave out.
        """
        queried = np.arange(self.segments) if segments is None else segments
        u, v = (b[queried].astype(np.float64) for b in (self.elevation_basis, self.azimuth_basis))
        segment_of_scan, last = self.segment_of_scan, -1
        for row in rows:
            own = int(segment_of_scan[row])
            if own != last:
                from_u = u.transpose(0, 2, 1) @ self.elevation_basis[own].astype(np.float64)
                from_v = self.azimuth_basis[own].astype(np.float64).T @ v
                last = own
            values = from_u @ self.signatures[row].astype(np.float64) @ from_v
            values[queried == own] = self.signatures[row]
            yield tuple(
                Signature(of_segment.astype(np.float32), segment, named)
                for of_segment, segment in zip(values, queried.tolist(), strict=True)
            )

    def basis_digests(self, parameters: "MapParameters") -> tuple[str, ...]:
        """Return the digests of the bases of the first 1, 2, ... L segments."""
        return paper_basis_digests(parameters, self.elevation_basis, self.azimuth_basis)

    def basis(
        self, revision: str, digest: str, parameters: "MapParameters", segments: IntArray
    ) -> PaperBasis:
        """Return the bases of some segments."""
        return PaperBasis(
            revision,
            digest,
            parameters,
            segments,
            self.elevation_basis[segments],
            self.azimuth_basis[segments],
        )

    def select(self, rows: IntArray, segments: IntArray, segment_start: IntArray) -> "PaperModel":
        """Return the model of some segments, unchanged."""
        return PaperModel(
            self.elevation_basis[segments],
            self.azimuth_basis[segments],
            self.signatures[rows],
            segment_start,
        )

    def joined(self, others: Sequence["PaperModel"], segment_start: IntArray) -> "PaperModel":
        """Return one model of this one's segments and those of others after it."""
        models = (self, *others)
        names = ("elevation_basis", "azimuth_basis", "signatures")
        parts = {name: np.concatenate([getattr(m, name) for m in models]) for name in names}
        return PaperModel(**parts, segment_start=segment_start)
