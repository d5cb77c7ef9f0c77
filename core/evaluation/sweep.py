"""Accuracy, relative error and storage for every {r1, r2, k} (paper, sec. 3.2 and fig. 4)."""

import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from core.arrays import BoolArray, Float32Array, IntArray, frozen
from core.encodings.signature import HEADER_BYTES, Signature, pack_signatures
from core.errors import InvalidParameters
from core.evaluation.criterion import Criterion, counted
from core.evaluation.plain import Plain
from core.evaluation.query_set import QuerySet
from core.mapping.pipeline import DriveImages, project_scans, rows_of_cuts
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.projection.imager import Views
from core.projection.visibility import FULL_VIEW, View
from core.scans.scan import Scan
from core.scans.stands import first_of_stands
from core.segmentation.fixed import cut_fixed
from core.text import verb_of


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

    def within(self, largest: tuple[int, int]) -> "SweepGrid":
        """Return the grid without ranks above the largest `(r1, r2)` that images have.

        Raises:
            InvalidParameters: If none is left.
        """
        kept: dict[str, tuple[int, ...]] = {}
        for name, tried, most in zip(("r1", "r2"), (self.r1, self.r2), largest, strict=True):
            kept[name] = tuple(rank for rank in tried if rank <= most)
            if not kept[name]:
                raise InvalidParameters(
                    f"{name} is {list(tried)}, wanted one of at most {most}, which images have"
                )
        return SweepGrid(**kept, segment_lengths=self.segment_lengths)

    def left_out(self, largest: tuple[int, int]) -> tuple[str, ...]:
        """Return sentences on the ranks that `within` leaves out.

        Examples:
            >>> SweepGrid((2, 25), (2, 3), (10,)).left_out((23, 91))
            ('r1 = 25 was not tried: the images have at most 23.',)
        """
        sentences = []
        for name, tried, most in zip(("r1", "r2"), (self.r1, self.r2), largest, strict=True):
            above = [rank for rank in tried if rank > most]
            if above:
                verb = verb_of(len(above), "was", "were")
                ranks = ", ".join(map(str, above))
                sentences.append(
                    f"{name} = {ranks} {verb} not tried: the images have at most {most}."
                )
        return tuple(sentences)


@dataclass(frozen=True, eq=False)
class QueryImages:
    """A drive's mapped images and those of its queries, made alike.

    Attributes:
        parameters: How images are made; the ranks are not used here.
        mapped: The mapped scans' images.
        queries: The scans that are queried, usable under every condition.
        cells: `(C, n, I, J)` float32, their images under each of the C conditions.
        refused: Scans that had no image under some condition.
    """

    parameters: MapParameters
    mapped: DriveImages
    queries: QuerySet
    cells: Float32Array
    refused: tuple[int, ...]

    @classmethod
    def of_drive(
        cls,
        held_out: BoolArray,
        queries: QuerySet,
        parameters: MapParameters,
        progress: Progress = NO_PROGRESS,
    ) -> "QueryImages":
        """Read and project a drive once.

        Raises:
            EmptyDrive: If no mapped scan is usable.
            InvalidParameters: If no query is.
        """
        mapped = project_scans(
            queries.drive, np.flatnonzero(~held_out), parameters, progress, most_probes=0
        )

        def image(_: int, scan: Scan) -> Float32Array:
            return parameters.imager.image(scan).cells

        (images,) = queries.answers([image], "querying", progress)
        usable = np.all([[cells is not None for cells in row] for row in images], axis=0)
        if not usable.any():
            raise InvalidParameters(f"not one of the {len(queries)} held-out scans is usable")
        cells = [[row[i] for i in np.flatnonzero(usable).tolist()] for row in images]
        return cls(
            parameters,
            mapped,
            replace(queries, scans=queries.scans[usable]),
            frozen(np.array(cells), np.float32),
            tuple(queries.scans[~usable].tolist()),
        )


@dataclass(frozen=True)
class SweepPoint(Plain):
    """One candidate.

    Attributes:
        ranks: `(r1, r2)`.
        segment_length: k, in scans of the drive before the split.
        segments: L, how many segments that gives.
        elements: Numbers that the map of the mapped scans holds.
        bytes_per_scan: The bytes of the map's bases, signatures and verification images, for each
            mapped scan.
        sent_bytes: The size of a query's signatures as a vehicle sends them.
        relative_error: |X - X^| / |X| over all mapped images.
        segment_accuracy: Share of the counted queries matched on their segment, as driven; a match
            of the same place on another pass, or beyond a cut, is not on it.
        accuracy: Share of right answers to counted queries, under each condition.
    """

    ranks: tuple[int, int]
    segment_length: int
    segments: int
    elements: int
    bytes_per_scan: float
    sent_bytes: int
    relative_error: float
    segment_accuracy: float
    accuracy: tuple[float, ...]

    @property
    def mean_accuracy(self) -> float:
        """Mean over the conditions: what the advisor compares."""
        return float(np.mean(self.accuracy))

    @property
    def size(self) -> tuple[float, int]:
        """What is kept and, among candidates that keep as much, what is sent."""
        return self.bytes_per_scan, self.sent_bytes


@dataclass(frozen=True)
class Sweep(Plain):
    """All candidates of one encoding on one query set.

    Attributes:
        encoding: The maps' encoding.
        conditions: What each entry of `accuracy` was measured under.
        criterion: Which answers are right.
        map_scans: Scans in each map.
        queries: How many there are under each condition.
        counted: How many of them count: stationary ones do not, if any was
            recorded while moving.
        points: The candidates by rising k, r1 and r2.
    """

    encoding: str
    conditions: tuple[dict[str, float], ...]
    criterion: str
    map_scans: int
    queries: int
    counted: int
    points: tuple[SweepPoint, ...]

    @property
    def sizes_differ(self) -> bool:
        """Whether a map of other ranks has another size; not if maps keep the largest ranks."""
        return sizes_differ(self.points)

    def at(self, ranks: tuple[int, int], segment_length: int) -> SweepPoint | None:
        """Return a candidate, `None` if it was not tried."""
        tried = {(point.ranks, point.segment_length): point for point in self.points}
        return tried.get((ranks, segment_length))


def sizes_differ(points: Sequence[SweepPoint]) -> bool:
    """Return whether candidates take more and less storage."""
    return len({round(point.bytes_per_scan) for point in points}) > 1


def sent_bytes(parameters: MapParameters, segments: int) -> int:
    """Return the size of a query's signatures as a vehicle sends them.

    Where a map answers any view, of one that is partial.
    """
    encoder = parameters.encoder
    partial = encoder.masks and parameters.views == Views.ANY
    one = Signature(
        np.ones(parameters.ranks, encoder.signature_dtype),
        0 if encoder.per_segment else None,
        "0" * 64,
        parameters.encoding,
        View(hidden=(0,)) if partial else FULL_VIEW,
    )
    of_one = len(pack_signatures([one])) - HEADER_BYTES
    return HEADER_BYTES + of_one * (segments if encoder.per_segment else 1)


def rows_of_length(mapped: IntArray, scans: int, length: int) -> IntArray:
    """Return the rows at which segments of k scans of a drive begin in a map of some of its scans.

    Args:
        mapped: Positions of the map's scans in the drive, rising.
        scans: How many scans the drive has.
        length: k.

    Raises:
        InvalidParameters: If a segment is left without a map scan.
    """
    try:
        return rows_of_cuts(mapped, cut_fixed(scans, length))
    except InvalidParameters as error:
        raise InvalidParameters(f"k = {length}: {error}") from error


def sweep(
    images: QueryImages, criterion: Criterion, grid: SweepGrid, progress: Progress = NO_PROGRESS
) -> Sweep:
    """Evaluate each (r1, r2, k) on one query set.

    Raises:
        InvalidParameters: If a segment is left without a map scan, or no rank fits the images.
    """
    encoder = images.parameters.encoder
    grid = grid.within(encoder.largest_ranks(images.parameters.grid.shape))
    drive_scans = len(images.queries.drive)
    cuts = [
        rows_of_length(images.mapped.scans, drive_scans, length) for length in grid.segment_lengths
    ]
    conditions, count = images.cells.shape[:2]
    rows, errors = encoder.rank_sweep(
        images.mapped,
        images.cells.reshape(-1, *images.cells.shape[2:]),
        cuts,
        (grid.r1, grid.r2),
        images.parameters,
        progress,
        first_of_stands(images.queries.drive.poses[images.mapped.scans]),
    )
    answered = rows.reshape(len(cuts), conditions, count, *rows.shape[2:])
    queried = images.queries.scans
    counts = counted(criterion.standing[queried])
    scans = images.mapped.scans
    right = criterion.right(queried[counts, None, None], scans[answered[:, :, counts]])
    as_driven = answered[:, 0][:, counts]
    points = []
    for i, (length, cut) in enumerate(zip(grid.segment_lengths, cuts, strict=True)):
        segment_start = cut_fixed(len(images.queries.drive), length)
        true = np.searchsorted(segment_start, queried[counts], side="right") - 1
        found = np.searchsorted(cut, as_driven[i], side="right") - 1
        in_segment = (found == true[:, None, None]).mean(axis=0)
        accuracy = right[i].mean(axis=1)
        for (a, r1), (b, r2) in itertools.product(enumerate(grid.r1), enumerate(grid.r2)):
            of_ranks = replace(images.parameters, ranks=(r1, r2))
            size = of_ranks, len(cut) - 1, len(scans)
            points.append(
                SweepPoint(
                    ranks=(r1, r2),
                    segment_length=length,
                    segments=len(cut) - 1,
                    elements=encoder.elements(*size),
                    bytes_per_scan=encoder.stored_bytes(*size) / len(scans),
                    sent_bytes=sent_bytes(of_ranks, len(cut) - 1),
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
        queries=len(queried),
        counted=int(counts.sum()),
        points=tuple(points),
    )
