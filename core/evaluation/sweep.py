"""Accuracy, relative error and storage for every {r1, r2, k} (paper, sec. 3.2 and fig. 4).

Bases of all ranks come from one eigendecomposition, and the signature at ranks (r1, r2) is the
leading block of that at larger ranks. So squared distances at all ranks are partial sums of one
squared difference, and images are encoded once a segment length, not once a candidate.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray
from core.encodings.grams import detail_gram
from core.encodings.harmonic import (
    HarmonicModel,
    encode,
    energy,
    harmonic_elements,
)
from core.encodings.signature import Signature
from core.encodings.tucker import BLOCK_SCANS, Grams, leading_basis, project, storage_elements
from core.errors import InvalidParameters
from core.evaluation.criterion import Criterion, counted
from core.evaluation.plain import Plain
from core.evaluation.query_images import QueryImages
from core.mapping.pipeline import rows_of_cuts
from core.parameters import Encoding
from core.progress import NO_PROGRESS, Progress
from core.segmentation import cut_fixed

__all__ = ["BYTES_A_NUMBER", "Sweep", "SweepGrid", "SweepPoint", "leading_sums", "sweep"]

BYTES_A_NUMBER = 4  # a map file keeps float32, or pairs of it


@dataclass(frozen=True)
class SweepGrid:
    """Which {r1, r2, k} are tried: every combination.

    Attributes:
        r1: Rising ranks of elevation (or rings).
        r2: Rising ranks of azimuth.
        segment_lengths: Rising k, in scans of the drive before the split.
    """

    r1: tuple[int, ...]
    r2: tuple[int, ...]
    segment_lengths: tuple[int, ...]

    def __post_init__(self) -> None:
        for name in ("r1", "r2", "segment_lengths"):
            values = tuple(sorted(set(getattr(self, name))))
            if not values or values[0] < 1:
                raise InvalidParameters(f"{name} is {list(values)}, wanted whole numbers above 0")
            object.__setattr__(self, name, values)

    def within(self, shape: tuple[int, int]) -> "SweepGrid":
        """Leave out ranks that images of this many rows and columns do not have.

        Raises:
            InvalidParameters: If none is left.
        """
        rows, columns = shape
        return SweepGrid(
            tuple(r for r in self.r1 if r <= rows),
            tuple(r for r in self.r2 if r <= columns),
            self.segment_lengths,
        )


@dataclass(frozen=True)
class SweepPoint(Plain):
    """One candidate.

    Attributes:
        ranks: `(r1, r2)`.
        segment_length: k, in scans of the drive before the split.
        segments: L, how many segments that gives.
        elements: Numbers that the map of the mapped scans holds.
        bytes_per_scan: Of that map, for each mapped scan.
        relative_error: |X - X^| / |X| over all mapped images.
        segment_accuracy: Share of the judged scans that were put on their segment, as driven.
        accuracy: Share of right answers to judged scans, under each condition.
    """

    ranks: tuple[int, int]
    segment_length: int
    segments: int
    elements: int
    bytes_per_scan: float
    relative_error: float
    segment_accuracy: float
    accuracy: tuple[float, ...]

    @property
    def mean_accuracy(self) -> float:
        """Mean over the conditions: what the advisor compares."""
        return float(np.mean(self.accuracy))


@dataclass(frozen=True)
class Sweep(Plain):
    """All candidates of one encoding on one query set.

    Attributes:
        encoding: Of the maps.
        conditions: What each entry of `accuracy` was measured under.
        criterion: What counts as right.
        map_scans: Scans in each map.
        asked: Scans that were asked, under each condition.
        judged: How many of them count: those taken standing do not, if any was taken moving.
        points: By rising k, r1 and r2.
    """

    encoding: Encoding
    conditions: tuple[dict[str, float], ...]
    criterion: str
    map_scans: int
    asked: int
    judged: int
    points: tuple[SweepPoint, ...]

    def at(self, ranks: tuple[int, int], segment_length: int) -> SweepPoint | None:
        """Return a candidate, `None` if it was not tried."""
        wanted = (ranks, segment_length)
        return next((p for p in self.points if (p.ranks, p.segment_length) == wanted), None)


def sweep(
    images: QueryImages, criterion: Criterion, grid: SweepGrid, progress: Progress = NO_PROGRESS
) -> Sweep:
    """Evaluate each (r1, r2, k) on one query set.

    Raises:
        InvalidParameters: If a segment is left without a map scan, or no rank fits the images.
    """
    rows, columns = images.parameters.grid.shape
    harmonic = images.parameters.encoding == Encoding.HARMONIC
    grid = grid.within((rows, columns // 2 + 1 if harmonic else columns))
    cuts = [
        rows_of_cuts(images.mapped.scans, cut_fixed(len(images.queries.drive), length))
        for length in grid.segment_lengths
    ]
    answer = _harmonic_answers if harmonic else _paper_answers
    answered, errors = answer(images, grid, cuts, progress)
    queried = images.queries.scans
    judged = counted(criterion.standing[queried])
    scans = images.mapped.scans
    right = criterion.right(queried[judged, None, None], scans[answered[:, :, judged]])
    as_driven = answered[:, 0][:, judged]
    points = []
    for i, (length, cut) in enumerate(zip(grid.segment_lengths, cuts, strict=True)):
        segment_start = cut_fixed(len(images.queries.drive), length)
        true = np.searchsorted(segment_start, queried[judged], side="right") - 1
        found = np.searchsorted(cut, as_driven[i], side="right") - 1
        in_segment = (found == true[:, None, None]).mean(axis=0)
        accuracy = right[i].mean(axis=1)
        for (a, r1), (b, r2) in itertools.product(enumerate(grid.r1), enumerate(grid.r2)):
            elements = _elements(images, len(cut) - 1, (r1, r2))
            points.append(
                SweepPoint(
                    ranks=(r1, r2),
                    segment_length=length,
                    segments=len(cut) - 1,
                    elements=elements,
                    bytes_per_scan=BYTES_A_NUMBER * elements / len(scans),
                    relative_error=float(errors[i, a, b]),
                    segment_accuracy=float(in_segment[a, b]),
                    accuracy=tuple(accuracy[:, a, b].tolist()),
                )
            )
    return Sweep(
        encoding=images.parameters.encoding,
        conditions=tuple(asdict(condition) for condition in images.queries.conditions),
        criterion=str(criterion),
        map_scans=len(scans),
        asked=len(queried),
        judged=int(judged.sum()),
        points=tuple(points),
    )


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


def _elements(images: QueryImages, segments: int, ranks: tuple[int, int]) -> int:
    scans, shape = len(images.mapped), images.parameters.grid.shape
    renderings = images.parameters.lateral_renderings_m
    if renderings is None:
        return storage_elements(segments, scans, shape, ranks)
    return harmonic_elements(scans, len(renderings), shape[0], ranks)


def _blocks(
    images: QueryImages, start: int, end: int, progress: Progress
) -> Iterator[Float32Array]:
    for first in range(start, end, BLOCK_SCANS):
        block = images.mapped.read(first, min(first + BLOCK_SCANS, end))
        yield block
        progress.advance(len(block))


def _paper_answers(
    images: QueryImages, grid: SweepGrid, cuts: Sequence[IntArray], progress: Progress
) -> tuple[IntArray, FloatArray]:
    """Return the nearest rows, `(lengths, C, n, r1, r2)`, and relative errors, `(lengths, ...)`."""
    conditions, count = images.cells.shape[:2]
    queried = images.cells.reshape(-1, *images.cells.shape[2:])
    ranks = (len(grid.r1), len(grid.r2))
    rows = np.zeros((len(cuts), len(queried), *ranks), dtype=np.int64)
    errors = np.zeros((len(cuts), *ranks))
    atoms = np.unique(np.concatenate(cuts))
    progress.start("summing", int(atoms[-1]))
    grams = []
    for start, end in itertools.pairwise(atoms.tolist()):
        total = Grams.zero(images.parameters.grid.shape)
        for block in _blocks(images, start, end, progress):
            total += Grams.of(block)
        grams.append(total)
    progress.start("sweeping", len(cuts) * int(atoms[-1]))
    for i, cut in enumerate(cuts):
        best = np.full((len(queried), *ranks), np.inf)
        kept, squared_norm = np.zeros(ranks), 0.0
        for start, end in itertools.pairwise(cut.tolist()):
            first, last = np.searchsorted(atoms, [start, end])
            total = sum(grams[first + 1 : last], grams[first])
            squared_norm += total.squared_norm
            # In single precision, as a map keeps them.
            u = leading_basis(total.elevation, grid.r1[-1]).astype(np.float32).astype(np.float64)
            v = leading_basis(total.azimuth, grid.r2[-1]).astype(np.float32).astype(np.float64)
            stored = project(images.mapped.read(start, end), u, v).astype(np.float32)
            kept += leading_sums(np.square(stored, dtype=np.float64).sum(axis=0), grid.r1, grid.r2)
            for q, signature in enumerate(project(queried, u, v).astype(np.float32)):
                squared = leading_sums(np.square(stored - signature), grid.r1, grid.r2)
                nearest = squared.argmin(axis=0)
                distance = np.take_along_axis(squared, nearest[None], axis=0)[0]
                closer = distance < best[q]
                best[q][closer] = distance[closer]
                rows[i, q][closer] = start + nearest[closer]
            progress.advance(end - start)
        errors[i] = np.sqrt(np.maximum(0.0, 1.0 - kept / squared_norm))
    return rows.reshape(len(cuts), conditions, count, *ranks), errors


def _harmonic_answers(
    images: QueryImages, grid: SweepGrid, cuts: Sequence[IntArray], progress: Progress
) -> tuple[IntArray, FloatArray]:
    """Return the same of a harmonic map: its basis is shared, so cuts change nothing."""
    parameters, scans = images.parameters, len(images.mapped)
    if parameters.distance is None or parameters.lateral_renderings_m is None:
        raise InvalidParameters("a harmonic map wants distance and lateral_renderings_m")
    image_rows, columns = parameters.grid.shape
    gram, squared_norm = np.zeros((image_rows, image_rows)), 0.0
    progress.start("summing", 2 * scans)
    for block in _blocks(images, 0, scans, progress):
        gram += detail_gram(block.reshape(-1, image_rows, columns))
        squared_norm += float(np.square(block, dtype=np.float64).sum())
    u = leading_basis(gram, grid.r1[-1]).astype(np.float32)
    stored = np.concatenate(
        [
            encode(block, u, grid.r2[-1]).astype(np.complex64)
            for block in _blocks(images, 0, scans, progress)
        ]
    )
    queried = encode(images.cells, u, grid.r2[-1]).astype(np.complex64)
    queried = queried.reshape(-1, *queried.shape[2:])
    rows = np.zeros((len(queried), len(grid.r1), len(grid.r2)), dtype=np.int64)
    errors = np.zeros((len(grid.r1), len(grid.r2)))
    progress.start("sweeping", rows.size)
    for (a, r1), (b, r2) in itertools.product(enumerate(grid.r1), enumerate(grid.r2)):
        model = HarmonicModel(
            radial_basis=u[:, :r1],
            signatures=stored[..., :r1, :r2],
            lateral_offset_m=np.array(parameters.lateral_renderings_m),
            segment_start=np.array([0, scans]),
            columns=columns,
            measure=parameters.distance,
        )
        kept = float(energy(stored[..., :r1, :r2], columns).sum())
        errors[a, b] = np.sqrt(max(0.0, 1.0 - kept / squared_norm))
        for q, values in enumerate(queried[:, :r1, :r2]):
            rows[q, a, b] = model.search([Signature(values, None, "")]).nearest(1)[0].row
            progress.advance()
    shape = (len(cuts), *images.cells.shape[:2], *errors.shape)
    return np.broadcast_to(rows.reshape(shape[1:]), shape), np.broadcast_to(
        errors, (len(cuts), *errors.shape)
    )
