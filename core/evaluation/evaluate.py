"""Build a map of one part of a drive and ask it where the other part was (paper, sec. 3)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from core.encodings.compression import Compression
from core.errors import EmptyDrive, InvalidParameters
from core.evaluation.condition import Condition
from core.evaluation.queries import Queries, ask, drive_queries, held_out_queries
from core.evaluation.result import Evaluation
from core.evaluation.split import Interleaved, Split
from core.evaluation.summary import summarize
from core.evaluation.tracks import Asked, cut_position, evaluate_tracks
from core.localization.localizer import Localizer
from core.mapping.pipeline import build, cut_scans, project_scans
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive
from core.segmentation import segment_length_for
from core.tracking.track import Tracker

__all__ = ["EvaluationProtocol", "evaluate"]


@dataclass(frozen=True)
class EvaluationProtocol:
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


def evaluate(
    drive: Drive,
    protocol: EvaluationProtocol,
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
    parameters = protocol.parameters
    segment_start = cut_scans(drive, length, parameters, progress)
    held_out = (
        protocol.split.held_out(segment_start)
        if query_drive is None
        else np.zeros(len(drive), dtype=bool)
    )
    if query_drive is None and not held_out.any():
        raise InvalidParameters("the split holds no scan out: there is nothing to ask")
    images = project_scans(drive, np.flatnonzero(~held_out), parameters, progress)
    tensor_map = build(
        [drive], parameters, lambda _: images, segment_start=segment_start, progress=progress
    ).tensor_map
    queries = (
        held_out_queries(drive, held_out, segment_start)
        if query_drive is None
        else drive_queries(query_drive, tensor_map)
    )
    localizer = Localizer(tensor_map)
    cuts = None if query_drive is not None else cut_position(images.scans, segment_start)
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
        skipped=images.skipped,
        compression=Compression.of(
            tensor_map.elements,
            scans=len(tensor_map),
            grid_shape=protocol.parameters.grid.shape,
            returns=images.returns,
        ),
        relative_error=tuple(tensor_map.relative_error.tolist()),
        conditions=tuple(
            summarize(condition, answers, elsewhere, queries, protocol.tolerances_m)
            for condition, (answers, elsewhere) in zip(
                protocol.conditions,
                ask(localizer, queries, unknown, protocol.conditions, protocol.seed, progress),
                strict=True,
            )
        ),
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


def _median_where(queries: Queries, *, standing: bool) -> float | None:
    if queries.standing is None:
        return None
    surrogate = queries.surrogate[queries.standing == standing]
    return float(np.median(surrogate)) if len(surrogate) else None
