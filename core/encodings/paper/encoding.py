"""The paper's encoding: each segment has bases of its own."""

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from core.encodings.base import Encoding
from core.encodings.basis import Basis
from core.encodings.blocks import read_blocks
from core.encodings.paper.basis import PaperBasis
from core.encodings.paper.model import PaperModel
from core.encodings.signature import HEADER_BYTES, Packing, Signature
from core.encodings.tucker import Grams, leading_basis, project, relative_error, storage_elements
from core.errors import InvalidSignature
from core.progress import Progress
from core.projection.imager import ImageKind
from core.projection.images import ImageSource
from core.projection.reducer import Reducer
from core.scans.trajectory import Trajectory

if TYPE_CHECKING:
    from core.encodings.model import Model
    from core.parameters import MapParameters

_FLOAT16, _FLOAT32 = 1, 2  # layouts


class PaperEncoding(Encoding):
    """Tucker2 models of range images, one a segment (paper, sec. 2.2)."""

    name = "paper"
    reducers: ClassVar = {ImageKind.RANGE: Reducer.LAST}
    implied_by = frozenset({Reducer.LAST, Reducer.NEAREST, Reducer.FARTHEST})
    dtypes: ClassVar = {"elevation_basis": "<f4", "azimuth_basis": "<f4", "signatures": "<f4"}
    layouts: ClassVar = {_FLOAT16: "float16", _FLOAT32: "float32"}
    per_segment = True
    shares_basis = False

    def elements(self, parameters: "MapParameters", segments: int, scans: int) -> int:
        """Return L(I r1 + J r2) + K r1 r2."""
        return storage_elements(segments, scans, parameters.grid.shape, parameters.ranks)

    def fit(
        self,
        images: ImageSource,
        trajectory: Trajectory,
        segment_start: IntArray,
        parameters: "MapParameters",
        progress: Progress,
        kept: Basis | None = None,
        grams: Mapping[str, FloatArray] | None = None,
    ) -> tuple["Model", FloatArray]:
        """Fit each segment's own bases, one segment after the other, in two passes each."""
        segments = len(segment_start) - 1
        (rows, columns), (r1, r2) = parameters.grid.shape, parameters.ranks
        elevation_basis = np.empty((segments, rows, r1), np.float32)
        azimuth_basis = np.empty((segments, columns, r2), np.float32)
        signatures = np.empty((len(images), r1, r2), np.float32)
        errors = np.empty(segments)
        shape = parameters.imager.shape
        progress.start("fitting", 2 * len(images))
        for segment, (start, end) in enumerate(itertools.pairwise(segment_start.tolist())):
            total = Grams.zero((rows, columns))
            for _, block in read_blocks(images, start, end, shape, progress):
                total += Grams.of(block)
            u, v = leading_basis(total.elevation, r1), leading_basis(total.azimuth, r2)
            for first, block in read_blocks(images, start, end, shape, progress):
                signatures[first : first + len(block)] = project(block, u, v)
            elevation_basis[segment], azimuth_basis[segment] = u, v
            errors[segment] = relative_error(total.squared_norm, signatures[start:end])
        return PaperModel(elevation_basis, azimuth_basis, signatures, segment_start), errors

    def explaining_grams(self, images: Float32Array) -> tuple[FloatArray, ...]:
        """Return the Gram matrices of both modes: a segment has a basis of each."""
        grams = Grams.of(images)
        return grams.elevation, grams.azimuth

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
        """Return the nearest row of every query and the relative errors (paper, fig. 4).

        Bases of all ranks come from one eigendecomposition, and the signature at ranks (r1, r2) is
        the leading block of that at larger ranks. So squared distances at all ranks are partial
        sums of one squared difference, and images are encoded once a segment length, not once a
        candidate.
        """
        r1, r2 = ranks
        counts = (len(r1), len(r2))
        rows = np.zeros((len(cuts), len(queries), *counts), dtype=np.int64)
        errors = np.zeros((len(cuts), *counts))
        atoms = np.unique(np.concatenate(cuts))
        progress.start("summing", int(atoms[-1]))
        grams = []
        for start, end in itertools.pairwise(atoms.tolist()):
            total = Grams.zero(images.grid.shape)
            for _, block in read_blocks(images, start, end, images.grid.shape, progress):
                total += Grams.of(block)
            grams.append(total)
        progress.start("sweeping", len(cuts) * int(atoms[-1]))
        for i, cut in enumerate(cuts):
            best = np.full((len(queries), *counts), np.inf)
            kept, squared_norm = np.zeros(counts), 0.0
            for start, end in itertools.pairwise(cut.tolist()):
                first, last = np.searchsorted(atoms, [start, end])
                total = sum(grams[first + 1 : last], grams[first])
                squared_norm += total.squared_norm
                u, v = leading_basis(total.elevation, r1[-1]), leading_basis(total.azimuth, r2[-1])
                stored = _single(project(images.read(start, end), u, v))
                kept += leading_sums(np.square(stored).sum(axis=0), r1, r2)
                for q, signature in enumerate(_single(project(queries, _single(u), _single(v)))):
                    squared = leading_sums(np.square(stored - signature), r1, r2)
                    nearest = squared.argmin(axis=0)
                    distance = np.take_along_axis(squared, nearest[None], axis=0)[0]
                    closer = distance < best[q]
                    best[q][closer] = distance[closer]
                    rows[i, q][closer] = start + nearest[closer]
                progress.advance(end - start)
            errors[i] = np.sqrt(np.maximum(0.0, 1.0 - kept / squared_norm))
        return rows, errors

    def read_model(
        self, parameters: "MapParameters", arrays: Mapping[str, NDArray[Any]]
    ) -> "Model":
        """Return the model of these arrays."""
        names = ("elevation_basis", "azimuth_basis", "signatures", "segment_start")
        return PaperModel(*(arrays[name] for name in names))

    def read_basis(
        self, revision: str, digest: str, parameters: "MapParameters", values: Mapping[str, Any]
    ) -> PaperBasis:
        """Return the bases of the segments listed."""
        listed = values["segments"]
        return PaperBasis(
            revision,
            digest,
            parameters,
            np.array([item["segment"] for item in listed]),
            np.array([item["elevation_basis"] for item in listed], dtype=np.float32),
            np.array([item["azimuth_basis"] for item in listed], dtype=np.float32),
        )

    def pack(self, signatures: Sequence[Signature], packing: Packing) -> tuple[int, bytes]:
        """Return the layout, and each signature's segment and numbers."""
        if packing != Packing.FLOAT16:
            raise InvalidSignature(f"only a harmonic signature is packed as {packing}")
        largest = max(float(np.abs(s.values).max()) for s in signatures)
        layout = _FLOAT16 if largest <= float(np.finfo(np.float16).max) else _FLOAT32
        record = _record(layout, signatures[0].values.shape)
        return layout, np.array([(s.segment, s.values) for s in signatures], record).tobytes()

    def unpack(
        self, layout: int, body: bytes, shape: tuple[int, int], revision: str
    ) -> tuple[Signature, ...]:
        """Read what `pack` returned."""
        record = _record(layout, shape)
        if not body or len(body) % record.itemsize:
            raise InvalidSignature(
                f"wanted {HEADER_BYTES} bytes and then {record.itemsize} for each signature,"
                f" got {HEADER_BYTES + len(body)} bytes"
            )
        records = np.frombuffer(body, record)
        return tuple(
            Signature(values, segment, revision)
            for segment, values in zip(records["segment"].tolist(), records["values"], strict=True)
        )

    def as_values(self, signature: Signature) -> dict[str, Any]:
        """Return the segment and `values`, r1 rows of r2 numbers."""
        return {"segment": signature.segment, "values": signature.values.tolist()}

    def from_values(self, values: Mapping[str, Any], revision: str) -> Signature:
        """Return the signature of a segment.

        Raises:
            InvalidSignature: If the rows differ in length or a number is beyond float32.
        """
        rows, segment = values["values"], values["segment"]
        if len({len(row) for row in rows}) > 1:
            raise InvalidSignature(f"the rows of segment {segment} differ in length")
        with np.errstate(over="ignore"):  # infinite then, and rejected as not finite
            found = np.array(rows, dtype=np.float64).astype(np.float32)
        return Signature(found, segment, revision)


def leading_sums(blocks: FloatArray, r1: Sequence[int], r2: Sequence[int]) -> FloatArray:
    """Return sums over the leading r1 x r2 block of `(..., R1, R2)`, for all `r1` and `r2`.

    Examples:
        >>> leading_sums(np.ones((4, 6)), [1, 3], [2, 6]).tolist()
        [[2.0, 6.0], [6.0, 18.0]]
    """
    within = blocks[..., : r1[-1], : r2[-1]]
    parts = np.add.reduceat(within, [0, *r1[:-1]], axis=-2)
    parts = np.add.reduceat(parts, [0, *r2[:-1]], axis=-1)
    return np.asarray(parts.cumsum(axis=-2).cumsum(axis=-1))


def _single(numbers: FloatArray) -> FloatArray:
    """Return numbers as a map keeps them, in single precision, for sums in double precision."""
    return numbers.astype(np.float32).astype(np.float64)


def _record(layout: int, shape: tuple[int, ...]) -> np.dtype[np.void]:
    """Return the dtype of one packed signature."""
    return np.dtype([("segment", "<u2"), ("values", "<f2" if layout == _FLOAT16 else "<f4", shape)])


ENCODING = PaperEncoding()
