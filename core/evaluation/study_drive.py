"""A study of a drive: sweep parameters, recommend some, disturb their queries (paper, sec. 3)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from core.arrays import BoolArray, IntArray
from core.errors import InvalidParameters
from core.evaluation.advisor import advise
from core.evaluation.condition import Condition
from core.evaluation.criterion import Criterion, counted
from core.evaluation.motion import motion_surrogate
from core.evaluation.query_set import QuerySet, hold_out, require_scans
from core.evaluation.split import Interleaved, Split
from core.evaluation.study import Answers, CurvePoint, EncodingStudy, Study
from core.evaluation.sweep import QueryImages, SweepGrid, rows_of_length, sweep
from core.localization.localizer import Localizer
from core.mapping.pipeline import build
from core.numbers import require_above, require_at_least
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.projection.images import Skipped
from core.scans.drive import Drive
from core.scans.sampling import spread_evenly
from core.scans.scan import Scan
from core.segmentation.fixed import cut_fixed

SWEPT_CONDITIONS = (Condition(), Condition(lateral_m=1.0))
"""As driven, and where the paper finds its limit: nearly every setting is right on the first."""


@dataclass(frozen=True)
class StudyProtocol:
    """How a drive is studied.

    Attributes:
        parameters: The maps' parameters, one for each encoding; their ranks are used if no others
            are recommended.
        r1: Ranks in elevation that are tried, as far as images have them.
        r2: Ranks in azimuth that are tried, as far as images have them.
        segment_lengths: k that are tried; without them, five that depend on the drive's length, but
            for those that leave a segment without a usable scan.
        ranks: Show the answers of these ranks instead of the recommended ones.
        segment_length: Show the answers of this k instead of the recommended one.
        split: Which scans are held out.
        max_queries: The largest number of queries.
        noise_m: Sigmas of noise on every coordinate.
        lateral_m: Translations to the left.
        yaw_deg: Relative yaws, counter-clockwise.
        max_bytes_per_scan: The advisor's budget.
        tolerance_m: Distance within which an answer is right.
        seed: The noise's seed.
    """

    parameters: tuple[MapParameters, ...]
    r1: tuple[int, ...] = (2, 3, 4, 5, 6, 8, 10, 15, 25)
    r2: tuple[int, ...] = (2, 3, 4, 5, 6, 8, 10, 15, 25)
    segment_lengths: tuple[int, ...] | None = None
    ranks: tuple[int, int] | None = None
    segment_length: int | None = None
    split: Split = field(default_factory=Interleaved)
    max_queries: int = 200
    noise_m: tuple[float, ...] = (0.0, 0.05, 0.1, 0.2, 0.5, 1.0)
    lateral_m: tuple[float, ...] = (-3.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 3.0)
    yaw_deg: tuple[float, ...] = (0.0, 5.0, 10.0, 45.0, 90.0, 180.0)
    max_bytes_per_scan: float | None = None
    tolerance_m: float = 3.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.parameters:
            raise InvalidParameters("parameters is empty, wanted those of at least one encoding")
        require_at_least(1, max_queries=self.max_queries)
        require_above(0, max_bytes_per_scan=self.max_bytes_per_scan)


def segment_lengths_for(scans: int) -> tuple[int, ...]:
    """Return the k that are tried on a drive: about 20, 12, 8, 5 and 2 segments.

    Each is at least 10 and a multiple of 5, so that a split of 80:20 falls on every segment alike.

    Examples:
        >>> segment_lengths_for(3800), segment_lengths_for(60)
        ((190, 315, 475, 760, 1900), (10, 30))
    """
    lengths = {max(10, 5 * round(scans / segments / 5)) for segments in (20, 12, 8, 5, 2)}
    return tuple(sorted(lengths))


def _mappable_lengths(mapped: IntArray, scans: int) -> tuple[int, ...]:
    """Return those of `segment_lengths_for` that leave no segment without a mapped scan.

    Where a stretch of a drive cannot be used a segment may be in it. Without any it is one segment.
    """
    lengths = segment_lengths_for(scans)
    kept = (k for k in lengths if np.diff(np.searchsorted(mapped, cut_fixed(scans, k))).all())
    return tuple(kept) or (scans,)


def held_out_scans(drive: Drive, split: Split, most: int) -> tuple[BoolArray, IntArray]:
    """Return which scans are not mapped, `(K,)`, and which of those are queries, rising.

    The drive is split as a whole: the same scans are held out with any segments. At most `most` of
    them are queries, spread evenly.

    Raises:
        InvalidParameters: If nothing is held out or nothing is left to map.
    """
    held_out = hold_out(split, np.array([0, len(drive)]))
    return held_out, spread_evenly(np.flatnonzero(held_out), most)


def study_drive(drive: Drive, protocol: StudyProtocol, progress: Progress = NO_PROGRESS) -> Study:
    """Sweep the parameters on a drive, recommend some, and disturb that map's queries.

    Raises:
        EmptyDrive: If the drive has no scan, or no usable one.
        InvalidParameters: If the split leaves no query, or a segment without a map scan, or images
            do not have ranks that are given. What does not depend on the scans is found before they
            are read.
    """
    require_scans(drive)
    held_out, scans = held_out_scans(drive, protocol.split, protocol.max_queries)
    _require_possible(protocol, np.flatnonzero(~held_out), len(drive))
    queries = QuerySet(drive, scans, SWEPT_CONDITIONS, protocol.seed)
    criterion = Criterion(drive.poses, drive.timestamp_s, protocol.tolerance_m)
    skipped: set[Skipped] = set()
    found: list[EncodingStudy] = []
    for parameters in protocol.parameters:
        named = _Named(progress, str(parameters.encoding))
        images = QueryImages.of_drive(held_out, queries, parameters, named)
        skipped.update(Skipped.numbered(drive, images.mapped.skipped))
        found.append(_study_encoding(images, criterion, protocol, named))
    return Study(
        drive=drive.name,
        timestamp_s=drive.timestamp_s,
        poses=drive.poses,
        surrogate=motion_surrogate(drive.poses),
        standing=criterion.standing,
        split=str(protocol.split),
        criterion=str(criterion),
        seed=protocol.seed,
        skipped=tuple(sorted(skipped, key=lambda s: (s.scan, s.reason))),
        encodings=tuple(found),
    )


def _require_possible(protocol: StudyProtocol, mapped: IntArray, scans: int) -> None:
    """Check, before long work, what is tried and shown as if all scans could be used."""
    shown = () if protocol.segment_length is None else (protocol.segment_length,)
    for length in (*(protocol.segment_lengths or ()), *shown):
        rows_of_length(mapped, scans, length)
    lengths = protocol.segment_lengths or (scans,)
    for parameters in protocol.parameters:
        largest = parameters.encoder.largest_ranks(parameters.grid.shape)
        SweepGrid(protocol.r1, protocol.r2, lengths).within(largest)
        if protocol.ranks is not None:
            replace(parameters, ranks=protocol.ranks)  # refuses ranks that images do not have


class _Named:
    """Prefixes each stage with the encoding's name."""

    def __init__(self, progress: Progress, name: str) -> None:
        self._progress = progress
        self._name = name

    def start(self, stage: str, total: int) -> None:
        self._progress.start(f"{self._name}: {stage}", total)

    def advance(self, units: int = 1) -> None:
        self._progress.advance(units)


def _study_encoding(
    images: QueryImages, criterion: Criterion, protocol: StudyProtocol, progress: Progress
) -> EncodingStudy:
    drive = images.queries.drive
    lengths = protocol.segment_lengths or _mappable_lengths(images.mapped.scans, len(drive))
    grid = SweepGrid(protocol.r1, protocol.r2, lengths)
    swept = sweep(images, criterion, grid, progress)
    advice = advise(swept.points, swept.counted, protocol.max_bytes_per_scan)
    largest = images.parameters.encoder.largest_ranks(images.parameters.grid.shape)
    advice = replace(advice, reasons=(*advice.reasons, *grid.left_out(largest)))
    ranks, length = protocol.ranks, protocol.segment_length
    if ranks is None:
        ranks = advice.recommended.ranks if advice.recommended else images.parameters.ranks
    if length is None:
        length = advice.recommended.segment_length if advice.recommended else lengths[-1]
    parameters = replace(images.parameters, ranks=ranks)
    rows_of_length(images.mapped.scans, len(drive), length)
    segment_start = cut_fixed(len(drive), length)
    made = build(
        [drive],
        parameters,
        lambda _: images.mapped,
        segment_start=segment_start,
        calibrated=False,
        progress=progress,
    )
    localizer = Localizer(made.tensor_map)
    scans = images.mapped.scans

    def localize(_: int, scan: Scan) -> int:
        search = localizer.search_image(localizer.basis.image(scan))
        return int(scans[search.nearest(1).rows[0]])  # of a whole answer nothing else is shown

    disturbed = replace(images.queries, conditions=_disturbances(protocol))
    (matched,) = disturbed.answers([localize], "localizing", progress)
    answers = [_answers(disturbed, criterion, row, segment_start) for row in matched]
    return EncodingStudy(
        parameters=parameters,
        sweep=swept,
        advice=advice,
        segment_length=length,
        segment_start=segment_start,
        recommended=advice.recommended is not None
        and (ranks, length) == (advice.recommended.ranks, advice.recommended.segment_length),
        relative_error=made.tensor_map.relative_error,
        compression=made.compression,
        answers=answers[0],
        curves=tuple(map(_curve_point, disturbed.conditions, answers)),
        refused=images.refused,
    )


def _disturbances(protocol: StudyProtocol) -> tuple[Condition, ...]:
    """Return every disturbance once, as driven first."""
    return tuple(
        dict.fromkeys(
            (
                Condition(),
                *(Condition(noise_m=sigma_m) for sigma_m in protocol.noise_m),
                *(Condition(lateral_m=left_m) for left_m in protocol.lateral_m),
                *(Condition(yaw_deg=turn_deg) for turn_deg in protocol.yaw_deg),
            )
        )
    )


def _answers(
    queries: QuerySet, criterion: Criterion, matched: Sequence[int | None], segment_start: IntArray
) -> Answers:
    """Return the answers; a disturbed scan without one is left out."""
    given = np.array([scan is not None for scan in matched], dtype=bool)
    scan, found = queries.scans[given], np.array([m for m in matched if m is not None], np.int64)
    return Answers(
        scan=scan,
        segment=np.searchsorted(segment_start, scan, side="right") - 1,
        matched_scan=found,
        matched_segment=np.searchsorted(segment_start, found, side="right") - 1,
        distance_m=criterion.distance_m(scan, found),
        right=criterion.right(scan, found),
        other_pass=criterion.other_pass(scan, found),
        standing=criterion.standing[scan],
    )


def _curve_point(condition: Condition, answers: Answers) -> CurvePoint:
    counts = counted(answers.standing)
    return CurvePoint(
        condition=condition,
        counted=int(counts.sum()),
        right=int(answers.right[counts].sum()),
        on_segment=int((~answers.wrong_segment)[counts].sum()),
    )
