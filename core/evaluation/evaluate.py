"""Build a map of one part of a drive and ask it where the other part was (paper, sec. 3)."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import KDTree

from core.arrays import BoolArray, FloatArray, IntArray
from core.builder import build_map
from core.compression import Compression
from core.displacement import left_of_m
from core.drive import Drive
from core.errors import EmptyDrive, InvalidParameters, InvalidScan
from core.evaluation.condition import Condition
from core.evaluation.motion import is_standing, motion_surrogate
from core.evaluation.reliability import Judged, Reliability, reliability
from core.evaluation.result import ConditionResult, Evaluation, SegmentError
from core.evaluation.split import Interleaved, Split
from core.evaluation.tracks import Asked, cut_position, evaluate_tracks
from core.images import ProjectedDrive, project_drive
from core.localizer import Localization, Localizer
from core.parameters import MapParameters, Segmentation
from core.places import AWAY_M
from core.pose import heading_deg, is_known
from core.progress import NO_PROGRESS, Progress
from core.segmentation import cut_fixed, cut_unequal, segment_length_for
from core.tensormap import TensorMap
from core.tracking.track import Tracker
from core.trajectory import Trajectory

__all__ = ["Protocol", "evaluate"]


@dataclass(frozen=True)
class Protocol:
    """How a drive is evaluated.

    Attributes:
        parameters: What the map is built with.
        segment_length: k in scans of the drive, before the split.
        segments: L instead, k = ceil(K / L).
        split: Which scans are held out; not used when another drive is the query.
        conditions: The disturbances of the queries.
        tolerances_m: Within which a match counts as recalled.
        track: Whether the queries are also tracked, as one vehicle's drive.
        seed: Of the noise; a scan's noise is the same whatever else is asked.
    """

    parameters: MapParameters = field(default_factory=MapParameters)
    segment_length: int | None = None
    segments: int | None = None
    split: Split = field(default_factory=Interleaved)
    conditions: tuple[Condition, ...] = (Condition(),)
    tolerances_m: tuple[float, ...] = (3.0, 5.0, 10.0)
    seed: int = 0
    track: bool = False

    def __post_init__(self) -> None:
        if not self.tolerances_m or not all(0 < m < math.inf for m in self.tolerances_m):
            raise InvalidParameters(f"tolerances_m is {self.tolerances_m}, wanted metres above 0")
        if self.seed < 0:
            raise InvalidParameters(f"seed is {self.seed}, wanted 0 or more")
        if not self.conditions:
            raise InvalidParameters("conditions is empty, wanted at least one")


@dataclass(frozen=True, eq=False)
class _Queries:
    """The scans that are asked, and what is true of them; rows of one drive."""

    drive: Drive
    scans: IntArray
    segment: IntArray  # -1 where no pose tells it
    standing: BoolArray | None
    surrogate: FloatArray


@dataclass(frozen=True)
class _Answer:
    scan: int
    segment: int
    matched_scan: int
    matched_segment: int
    matched: FloatArray  # (7,) pose row of the map's scan
    estimated: FloatArray  # (7,) pose row of the vehicle, the map's scan where there is no better
    heading_told: bool
    lateral_m: float | None
    seconds: float
    probability: float | None
    localized: bool


def evaluate(
    drive: Drive,
    protocol: Protocol,
    query_drive: Drive | None = None,
    progress: Progress = NO_PROGRESS,
    unknown: Sequence[Drive] = (),
) -> Evaluation:
    """Evaluate localization on a drive against itself, or against a second pass.

    Segments are cut over all scans of the drive, then split; unlike a build's, not where the drive
    meets itself, which models do not depend on. With a query drive the whole of
    `drive` is the map, both share one world frame, and a query's true segment is that of the
    nearest map scan. Scans of `unknown` drives, which share no place with the map, are asked under
    the same conditions: whatever the map answers them is wrong.

    Raises:
        EmptyDrive: If a drive has no scan, or the map's no usable one.
        InvalidParameters: If the split leaves a segment without a map scan or nothing to ask.
    """
    for asked in (drive, drive if query_drive is None else query_drive, *unknown):
        if len(asked) == 0:
            raise EmptyDrive(f"drive {asked.name} has no scan")
    length = segment_length_for(
        len(drive), segment_length=protocol.segment_length, segments=protocol.segments
    )
    segment_start = _cut(drive, length, protocol.parameters, progress)
    held_out = (
        protocol.split.held_out(segment_start)
        if query_drive is None
        else np.zeros(len(drive), dtype=bool)
    )
    if query_drive is None and not held_out.any():
        raise InvalidParameters("the split holds no scan out: there is nothing to ask")
    projected = project_drive(
        drive,
        np.flatnonzero(~held_out),
        protocol.parameters.imager,
        progress,
    )
    tensor_map = _build(drive, projected, segment_start, protocol.parameters, progress)
    queries = (
        _held_out_queries(drive, held_out, segment_start)
        if query_drive is None
        else _drive_queries(query_drive, tensor_map)
    )
    localizer = Localizer(tensor_map)
    cuts = None if query_drive is not None else cut_position(projected.scans, segment_start)
    return Evaluation(
        drive=drive.name,
        query_drive=None if query_drive is None else query_drive.name,
        unknown_drives=tuple(of_unknown.name for of_unknown in unknown),
        calibrated=tensor_map.calibration is not None,
        encoding=str(protocol.parameters.encoding),
        ranks=protocol.parameters.ranks,
        segments=tensor_map.model.segments,
        segmentation=str(protocol.parameters.segmentation),
        split=str(protocol.split) if query_drive is None else None,
        reducer=str(protocol.parameters.reducer),
        image=str(protocol.parameters.image),
        distance=None
        if protocol.parameters.distance is None
        else str(protocol.parameters.distance),
        lateral_renderings_m=protocol.parameters.lateral_renderings_m,
        sensor=protocol.parameters.sensor,
        sensor_height_m=protocol.parameters.sensor_height_m,
        seed=protocol.seed,
        map_scans=len(tensor_map),
        standing_scans=None if queries.standing is None else int(queries.standing.sum()),
        motion_surrogate_median_standing=_median_where(queries, standing=True),
        motion_surrogate_median_moving=_median_where(queries, standing=False),
        skipped=projected.skipped,
        compression=Compression.of(
            tensor_map.elements,
            scans=len(tensor_map),
            grid_shape=protocol.parameters.grid.shape,
            returns=projected.returns,
        ),
        relative_error=tuple(tensor_map.relative_error.tolist()),
        conditions=_ask(localizer, queries, unknown, protocol, progress),
        tracks=evaluate_tracks(
            Tracker(localizer, cut_position=cuts),
            Asked(queries.drive, queries.scans, queries.segment, queries.standing),
            protocol.conditions,
            protocol.tolerances_m,
            protocol.seed,
            progress,
        )
        if protocol.track
        else (),
    )


def _cut(drive: Drive, length: int, parameters: MapParameters, progress: Progress) -> IntArray:
    """Return `(L + 1,)` scans of the drive at which segments begin, and their number."""
    if parameters.segmentation == Segmentation.FIXED:
        return cut_fixed(len(drive), length)
    everything = np.arange(len(drive))
    projected = project_drive(drive, everything, parameters.imager, progress)
    scans = projected.scans
    trajectory = Trajectory.of_drive(
        drive.name, drive.timestamp_s[scans], drive.poses[scans], scans
    )
    cuts = cut_unequal(projected.images, trajectory, length, parameters, progress)
    return np.concatenate([[0], scans[cuts[1:-1]], [len(drive)]])


def _build(
    drive: Drive,
    projected: ProjectedDrive,
    segment_start: IntArray,
    parameters: MapParameters,
    progress: Progress,
) -> TensorMap:
    scans = projected.scans
    map_start = np.searchsorted(scans, segment_start)
    empty = np.flatnonzero(np.diff(map_start) == 0)
    if len(empty):
        raise InvalidParameters(
            f"segment {empty[0]} is left without a map scan: take longer segments or another split"
        )
    trajectory = Trajectory.of_drive(
        drive.name, drive.timestamp_s[scans], drive.poses[scans], scans
    )
    probes = projected.probes_of_map()
    return build_map(projected.images, trajectory, map_start, parameters, progress, probes)


def _queries(drive: Drive, scans: IntArray, segment: IntArray) -> _Queries:
    known = bool(is_known(drive.poses).all())
    return _Queries(
        drive,
        scans,
        segment,
        is_standing(drive.poses, drive.timestamp_s)[scans] if known else None,
        motion_surrogate(drive.poses)[scans],
    )


def _median_where(queries: _Queries, *, standing: bool) -> float | None:
    if queries.standing is None:
        return None
    surrogate = queries.surrogate[queries.standing == standing]
    return float(np.median(surrogate)) if len(surrogate) else None


def _held_out_queries(drive: Drive, held_out: BoolArray, segment_start: IntArray) -> _Queries:
    scans = np.flatnonzero(held_out)
    return _queries(drive, scans, np.searchsorted(segment_start, scans, side="right") - 1)


def _drive_queries(drive: Drive, tensor_map: TensorMap) -> _Queries:
    scans = np.arange(len(drive))
    mapped = tensor_map.trajectory.known
    asked = is_known(drive.poses)
    segment = np.full(len(drive), -1)
    if mapped.any() and asked.any():
        tree = KDTree(tensor_map.trajectory.poses[mapped, :3])
        nearest = np.flatnonzero(mapped)[tree.query(drive.poses[asked, :3])[1]]
        segment[asked] = tensor_map.model.segment_of_scan[nearest]
    return _queries(drive, scans, segment)


def _ask(
    localizer: Localizer,
    queries: _Queries,
    unknown: Sequence[Drive],
    protocol: Protocol,
    progress: Progress,
) -> tuple[ConditionResult, ...]:
    """Read each query once and ask it under every condition."""
    answers: list[list[_Answer]] = [[] for _ in protocol.conditions]
    scans = len(queries.scans) + sum(len(drive) for drive in unknown)
    progress.start("localizing", scans * len(protocol.conditions))
    segments = dict(zip(queries.scans.tolist(), queries.segment.tolist(), strict=True))
    for scan_index, segment in segments.items():
        for given, asked in zip(
            answers, _asked(localizer, queries.drive, scan_index, protocol, progress), strict=True
        ):
            if asked is not None:
                given.append(_answer(localizer, *asked, scan_index, segment))
    elsewhere: list[list[Localization]] = [[] for _ in protocol.conditions]
    for drive in unknown:
        for scan_index in range(len(drive)):
            for told, asked in zip(
                elsewhere, _asked(localizer, drive, scan_index, protocol, progress), strict=True
            ):
                if asked is not None:
                    told.append(asked[0])
    return tuple(
        _summarize(condition, given, told, queries, protocol.tolerances_m)
        for condition, given, told in zip(protocol.conditions, answers, elsewhere, strict=True)
    )


def _asked(
    localizer: Localizer, drive: Drive, scan_index: int, protocol: Protocol, progress: Progress
) -> list[tuple[Localization, float] | None]:
    """Return the answers to a scan under every condition and their seconds; `None` for none."""
    try:
        scan = drive.scan(scan_index)
    except InvalidScan:
        progress.advance(len(protocol.conditions))
        return [None] * len(protocol.conditions)
    answers: list[tuple[Localization, float] | None] = []
    for condition in protocol.conditions:
        rng = np.random.default_rng([protocol.seed, scan_index])
        try:
            disturbed = condition.apply(scan, rng)
            begun = time.perf_counter()
            found = localizer.localize_scan(disturbed)
            answers.append((found, time.perf_counter() - begun))
        except InvalidScan:
            answers.append(None)
        progress.advance()
    return answers


def _answer(
    localizer: Localizer, found: Localization, seconds: float, scan_index: int, segment: int
) -> _Answer:
    best = found.best
    matched, estimated = localizer.map.trajectory.poses[best.row], best.estimated_pose
    return _Answer(
        scan_index,
        segment,
        best.scan_index,
        best.segment,
        matched,
        matched if estimated is None else np.array(estimated.as_tuple()),
        best.heading_deg is not None,
        best.lateral_m,
        seconds,
        found.verdict.probability,
        found.localized,
    )


def _summarize(
    condition: Condition,
    answers: Sequence[_Answer],
    elsewhere: Sequence[Localization],
    queries: _Queries,
    tolerances_m: Sequence[float],
) -> ConditionResult:
    row_of = {scan: row for row, scan in enumerate(queries.scans.tolist())}
    judged = [a for a in answers if a.segment >= 0]
    wrong = [a for a in judged if a.matched_segment != a.segment]
    errors = tuple(_segment_error(a, queries, row_of[a.scan]) for a in wrong)
    tells = queries.standing is not None and bool(judged)
    standing = sum(bool(e.standing) for e in errors) if tells else None
    poses = queries.drive.poses
    true = [condition.pose(poses[a.scan]) for a in answers]
    recorded_m = _distances_m([a.matched for a in answers], [poses[a.scan] for a in answers])
    displaced_m = _distances_m([a.estimated for a in answers], true)
    turned = [
        _heading_error_deg(a.estimated, pose)
        for a, pose in zip(answers, true, strict=True)
        if a.heading_told
    ]
    beside = [
        abs(a.lateral_m - left_of_m(a.matched, pose))
        for a, pose in zip(answers, true, strict=True)
        if a.lateral_m is not None
    ]
    return ConditionResult(
        condition=condition,
        queries=len(queries.scans),
        refusals=len(queries.scans) - len(answers),
        segment_accuracy=1.0 - len(wrong) / len(judged) if judged else None,
        errors=errors,
        errors_moving=None if standing is None else len(errors) - standing,
        errors_stationary=standing,
        recall_at_1={
            metres: float(np.mean(recorded_m <= metres)) if len(recorded_m) else None
            for metres in tolerances_m
        },
        position_error_m_median=_median(displaced_m),
        heading_error_deg_median=_median(np.array(turned)),
        lateral_error_m_median=_median(np.array(beside)),
        reliability=_reliability(answers, elsewhere, true),
        ms_per_query=1e3 * float(np.mean([a.seconds for a in answers])) if answers else None,
    )


def _reliability(
    answers: Sequence[_Answer], elsewhere: Sequence[Localization], true: Sequence[FloatArray]
) -> Reliability | None:
    """Judge probabilities; a match is right within `AWAY_M`, as it is when they are learned."""
    known = [
        Judged(
            answer.probability,
            answer.localized,
            bool(np.linalg.norm(answer.matched[:3] - pose[:3]) < AWAY_M),
        )
        for answer, pose in zip(answers, true, strict=True)
        if answer.probability is not None
        and np.isfinite(answer.matched).all()
        and np.isfinite(pose).all()
    ]
    if not known:
        return None
    unknown = [
        Judged(found.verdict.probability, found.localized, right=False)
        for found in elsewhere
        if found.verdict.probability is not None
    ]
    return reliability(known, unknown)


def _segment_error(answer: _Answer, queries: _Queries, row: int) -> SegmentError:
    surrogate = float(queries.surrogate[row])
    return SegmentError(
        scan=answer.scan,
        matched_scan=answer.matched_scan,
        segment=answer.segment,
        matched_segment=answer.matched_segment,
        standing=None if queries.standing is None else bool(queries.standing[row]),
        motion_surrogate=None if np.isnan(surrogate) else surrogate,
    )


def _distances_m(found: Sequence[FloatArray], true: Sequence[FloatArray]) -> FloatArray:
    """Return how far the found poses are from the true ones, where both are known."""
    if not found:
        return np.empty(0)
    distances = np.linalg.norm(np.stack(found)[:, :3] - np.stack(true)[:, :3], axis=1)
    return np.asarray(distances[np.isfinite(distances)])


def _heading_error_deg(estimated: FloatArray, true: FloatArray) -> float:
    found, wanted = heading_deg(np.stack([estimated, true])).tolist()
    error: float = abs((found - wanted + 180.0) % 360.0 - 180.0)
    return error


def _median(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None
