"""Build a map of one part of a drive and query it with the other part (paper, sec. 3)."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.encodings.compression import Compression
from core.evaluation.disturbances import Recording
from core.evaluation.metrics import median
from core.evaluation.nearest import nearest_place
from core.evaluation.plain import Plain
from core.evaluation.query_set import (
    LocatedQueries,
    QueryProtocol,
    QuerySet,
    hold_out,
    require_scans,
)
from core.evaluation.split import Interleaved, Split
from core.evaluation.summary import Answer, ConditionResult, summarize
from core.evaluation.tracks import TrackResult, cut_position, evaluate_tracks
from core.localization.localizer import Localizer
from core.mapping.pipeline import build, cut_scans, project_scans
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.projection.images import MemoryBuffer, NewBuffer, ProjectedDrive, Skipped
from core.scans.drive import Drive
from core.scans.scan import Scan
from core.scans.sensor import sensor_named
from core.scans.stands import STAND_M
from core.segmentation.fixed import segment_length_for
from core.tracking.track import Tracker


@dataclass(frozen=True)
class EvaluationProtocol(QueryProtocol):
    """How a drive is evaluated.

    Attributes:
        parameters: What the map is built with.
        segment_length: k in scans of the drive, before the split.
        segments: L instead, k = ceil(K / L).
        split: Which scans are held out; not used when another drive is the query.
        track: Whether the queries are also tracked, as one vehicle's drive.
    """

    parameters: MapParameters = field(default_factory=MapParameters)
    segment_length: int | None = None
    segments: int | None = None
    split: Split = field(default_factory=Interleaved)
    track: bool = False


@dataclass(frozen=True)
class Evaluation(Plain):
    """A map of one part of a drive, queried with the other part or with another drive.

    Attributes:
        drive: Name of the mapped drive; `query_drive` is `None` if its own scans are the queries.
        unknown_drives: Names of the drives whose places the map does not have.
        calibrated: Whether the map has probabilities of scans, which are the queries.
        segments: L.
        segmentation: How they were cut.
        split: How the queries were held out, `None` with a query drive.
        distance: How harmonic signatures are compared, `None` in the paper's encoding.
        lateral_renderings_m: The viewpoints that the map's scans were rendered from, `None` in the
            paper's encoding.
        views: Which views the map answers.
        map_scans: How many scans the map has.
        standing_scans: Queries recorded while stationary, `None` without poses.
        motion_surrogate_median_standing: Median norm of the 6-DOF change of those queries.
        motion_surrogate_median_moving: Median norm of the change of all other queries.
        skipped: Scans that could not be mapped.
        compression: Against the map's own images and returns.
        relative_error: |X - X^| / |X| of each segment.
        conditions: The figures, one entry a disturbance.
        tracks: The figures of tracking the queries as one drive; empty without it.
    """

    drive: str
    query_drive: str | None
    unknown_drives: tuple[str, ...]
    calibrated: bool
    encoding: str
    ranks: tuple[int, int]
    segments: int
    segmentation: str
    split: str | None
    reducer: str
    image: str
    distance: str | None
    lateral_renderings_m: tuple[float, ...] | None
    views: str
    sensor: str
    sensor_height_m: float
    seed: int
    map_scans: int
    standing_scans: int | None
    motion_surrogate_median_standing: float | None
    motion_surrogate_median_moving: float | None
    skipped: tuple[Skipped, ...]
    compression: Compression
    relative_error: tuple[float, ...]
    conditions: tuple[ConditionResult, ...]
    tracks: tuple[TrackResult, ...] = ()


def evaluate(
    drive: Drive,
    protocol: EvaluationProtocol,
    query_drive: Drive | None = None,
    progress: Progress = NO_PROGRESS,
    unknown: Sequence[Drive] = (),
    new_buffer: NewBuffer = MemoryBuffer,
    rendered: ProjectedDrive | None = None,
) -> Evaluation:
    """Evaluate localization on a drive against itself, or against a second pass.

    Segments are cut over all scans of the drive, then split; unlike a build's, neither at turns
    nor where the drive meets itself. With a query drive the whole of `drive` is the map, both share
    one world frame, and a query's true segment is that of the nearest map scan; it has none if that
    is farther away than the greatest tolerance. Where a vehicle
    stood while segments were cut, any of these is right for a track: they are of one place. Scans
    of `unknown` drives, which share no place with the map, are queried under the same conditions:
    whatever the map answers them is wrong.

    Images of the map's scans are kept in a buffer that `new_buffer` makes: in memory by default, 43
    kB a scan and rendering on the paper's grid. Scans of `drive` that are in `rendered`, by the
    imager of the map's parameters, are not rendered again: several evaluations may share them.

    Raises:
        EmptyDrive: If a drive has no scan, or the map's no usable one.
        InvalidParameters: If the split leaves a segment without a map scan or nothing to query.
    """
    require_scans(drive, *([] if query_drive is None else [query_drive]), *unknown)
    parameters, conditions = protocol.parameters, protocol.conditions
    length = segment_length_for(
        len(drive), segment_length=protocol.segment_length, segments=protocol.segments
    )
    segment_start, whole = cut_scans(
        drive, length, parameters, progress, new_buffer, rendered=rendered
    )
    held_out = np.zeros(len(drive), dtype=bool)
    if query_drive is None:
        held_out = hold_out(protocol.split, segment_start)
    mapped = np.flatnonzero(~held_out)
    images = project_scans(
        drive,
        mapped,
        parameters,
        progress,
        rendered=rendered if whole is None else whole,
        new_buffer=new_buffer,
    )
    del whole  # as large as these, and no longer needed
    made = build(
        [drive], parameters, lambda _: images, segment_start=segment_start, progress=progress
    )
    tensor_map = made.tensor_map
    localizer = Localizer(tensor_map)
    queries = _queries(
        drive, query_drive, held_out, images.scans, segment_start, tensor_map, protocol
    )
    answers = _answered(localizer, queries, "localizing", progress)
    elsewhere = _answered_elsewhere(localizer, unknown, queries, progress)
    tracks: tuple[TrackResult, ...] = ()
    if protocol.track:
        cuts = cut_position(images.scans, segment_start) if query_drive is None else None
        tracker = Tracker(localizer, cut_position=cuts)
        tracks = evaluate_tracks(tracker, queries, protocol.tolerances_m, progress)
    return Evaluation(
        drive=drive.name,
        query_drive=None if query_drive is None else query_drive.name,
        unknown_drives=tuple(of_unknown.name for of_unknown in unknown),
        calibrated=tensor_map.calibration_of_scans is not None,
        encoding=parameters.encoding,
        ranks=parameters.ranks,
        segments=tensor_map.model.segments,
        segmentation=parameters.segmentation,
        split=str(protocol.split) if query_drive is None else None,
        reducer=parameters.reducer,
        image=parameters.image,
        distance=parameters.distance,
        lateral_renderings_m=parameters.lateral_renderings_m,
        views=parameters.views,
        sensor=parameters.sensor,
        sensor_height_m=parameters.sensor_height_m,
        seed=protocol.seed,
        map_scans=len(tensor_map),
        standing_scans=None if queries.standing is None else int(queries.standing.sum()),
        motion_surrogate_median_standing=_median_where(queries, standing=True),
        motion_surrogate_median_moving=_median_where(queries, standing=False),
        skipped=made.skipped[drive.name],
        compression=made.compression,
        relative_error=tuple(tensor_map.relative_error.tolist()),
        conditions=tuple(
            summarize(condition, tensor_map, queries, found, of_unknown, protocol.tolerances_m)
            for condition, found, of_unknown in zip(conditions, answers, elsewhere, strict=True)
        ),
        tracks=tracks,
    )


def _queries(
    drive: Drive,
    query_drive: Drive | None,
    held_out: BoolArray,
    mapped: IntArray,
    segment_start: IntArray,
    tensor_map: TensorMap,
    protocol: EvaluationProtocol,
) -> LocatedQueries:
    """Return the scans that were held out, or those of a second pass, with their true segments."""
    if query_drive is None:
        queried, scans = drive, np.flatnonzero(held_out)
        own = np.searchsorted(segment_start, scans, side="right") - 1
        beside = _nearest_beside(drive.poses, scans, mapped)
        _, nearest_m = nearest_place(tensor_map.trajectory.poses, drive.poses[scans])
    else:
        queried, scans = query_drive, np.arange(len(query_drive))
        beside, nearest_m = nearest_place(tensor_map.trajectory.poses, query_drive.poses)
        beside = np.where(nearest_m <= max(protocol.tolerances_m), beside, -1)
        own = np.where(beside < 0, -1, tensor_map.model.segment_of_scan[beside])
    there = tensor_map.model.segment_of_scan[tensor_map.trajectory.stands[beside]]
    in_stand = (beside >= 0) & (there[:, 0] < there[:, 1])
    there[~in_stand] = own[~in_stand, None]
    segments = np.column_stack([np.minimum(own, there[:, 0]), np.maximum(own, there[:, 1])])
    parameters = protocol.parameters
    recording = Recording(sensor_named(parameters.sensor), parameters.sensor_height_m)
    return LocatedQueries(
        queried,
        scans,
        protocol.conditions,
        protocol.seed,
        own,
        segments,
        nearest_m,
        recording=recording,
    )


def _answered(
    localizer: Localizer, queries: QuerySet, stage: str, progress: Progress
) -> list[list[Answer | None]]:
    """Return the answers to queries, with the time that each took, by condition and query."""

    def localize(_: int, scan: Scan) -> Answer:
        begun = time.perf_counter()
        found = localizer.localize_scan(scan)
        return Answer(found, time.perf_counter() - begun)

    return queries.answers([localize], stage, progress)[0]


def _answered_elsewhere(
    localizer: Localizer, unknown: Sequence[Drive], like: QuerySet, progress: Progress
) -> list[list[Answer | None]]:
    """Return the answers to all scans of some drives, queried as others are, by condition."""
    answers: list[list[Answer | None]] = [[] for _ in like.conditions]
    for drive in unknown:
        every = np.arange(len(drive))
        queries = QuerySet(drive, every, like.conditions, like.seed, recording=like.recording)
        found = _answered(localizer, queries, f"localizing {drive.name}", progress)
        for of_condition, more in zip(answers, found, strict=True):
            of_condition += more
    return answers


def _nearest_beside(poses: FloatArray, scans: IntArray, mapped: IntArray) -> IntArray:
    """Return the row of the nearer of the mapped scans before and after each of some others.

    -1 where neither is so near that both could be of one stand.
    """
    after = np.searchsorted(mapped, scans)
    beside = np.clip(np.stack([after - 1, after], axis=1), 0, len(mapped) - 1)
    apart_m = np.linalg.norm(poses[mapped[beside], :3] - poses[scans, None, :3], axis=2)
    apart_m = np.where(apart_m < STAND_M, apart_m, np.inf)
    rows = np.take_along_axis(beside, apart_m.argmin(axis=1)[:, None], axis=1)[:, 0]
    return np.where(np.isfinite(apart_m).any(axis=1), rows, -1)


def _median_where(queries: LocatedQueries, *, standing: bool) -> float | None:
    if queries.standing is None:
        return None
    return median(queries.surrogate[queries.standing == standing])
