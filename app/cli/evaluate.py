"""`tensormap evaluate`: how well a map of a drive answers."""

from pathlib import Path
from typing import Annotated

import typer

from app.cli.console import output, progress_bar
from app.cli.evaluation import (
    PROTOCOL,
    JsonOption,
    LateralOption,
    NoiseOption,
    SeedOption,
    SplitOption,
    ToleranceOption,
    YawOption,
    figure,
    opened,
    show,
    show_conditions,
    split_of,
    write_figures,
)
from app.cli.options import (
    DistanceOption,
    DriveArgument,
    EncodingOption,
    ImageOption,
    LateralRenderingsOption,
    RanksOption,
    ReducerOption,
    SegmentationOption,
    SegmentLengthOption,
    SegmentsOption,
    SensorHeightOption,
    SensorOption,
    height_m,
    numbers,
    ranks,
    require_folder,
)
from core.encodings.registry import encoding_with
from core.errors import InvalidParameters
from core.evaluation.condition import conditions
from core.evaluation.evaluate import EvaluationProtocol
from core.evaluation.evaluate import evaluate as evaluate_drive
from core.evaluation.result import Evaluation
from core.parameters import MapParameters, Segmentation
from core.projection.imager import ImageKind
from core.scans.sensor import HDL_64E


def evaluate(
    drive: DriveArgument,
    query_drive: Annotated[
        Path | None,
        typer.Option(
            metavar="DRIVE2",
            help="Query with this drive, in the same world frame; DRIVE as a whole is the map.",
            rich_help_panel=PROTOCOL,
        ),
    ] = None,
    unknown: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="DRIVE3",
            help="Query with this drive too, of places that are not in the map; repeatable.",
            rich_help_panel=PROTOCOL,
        ),
    ] = None,
    encoding: EncodingOption = None,
    ranks_text: RanksOption = "5,5",
    segmentation: SegmentationOption = Segmentation.FIXED,
    segment_length: SegmentLengthOption = None,
    segments: SegmentsOption = None,
    reducer: ReducerOption = None,
    image: ImageOption = None,
    distance: DistanceOption = None,
    lateral_renderings: LateralRenderingsOption = None,
    sensor: SensorOption = HDL_64E.name,
    sensor_height_m: SensorHeightOption = None,
    split: SplitOption = None,
    yaw_deg: YawOption = "0",
    lateral_m: LateralOption = "0",
    noise_m: NoiseOption = "0",
    tolerance_m: ToleranceOption = "3,5,10",
    seed: SeedOption = 0,
    track: Annotated[
        bool,
        typer.Option(
            "--track",
            help="Also track them one after another, as one vehicle's drive.",
            rich_help_panel=PROTOCOL,
        ),
    ] = False,
    json_out: JsonOption = None,
) -> None:
    """Build a map of one part of a drive and query it with the other part."""
    if json_out is not None:
        require_folder(json_out)
    if query_drive is not None and split is not None:
        raise InvalidParameters("with --query-drive all of DRIVE is the map: leave --split out")
    protocol = EvaluationProtocol(
        parameters=MapParameters.for_sensor(
            sensor,
            encoding=encoding or encoding_with(reducer),
            ranks=ranks(ranks_text),
            reducer=reducer,
            sensor_height_m=sensor_height_m,
            image=image,
            distance=distance,
            lateral_renderings_m=(
                None if lateral_renderings is None else numbers(lateral_renderings)
            ),
            segmentation=segmentation,
        ),
        segment_length=segment_length,
        segments=segments,
        split=split_of(split),
        conditions=conditions(numbers(yaw_deg), numbers(lateral_m), numbers(noise_m)),
        tolerances_m=numbers(tolerance_m),
        seed=seed,
        track=track,
    )
    if protocol.parameters.image == ImageKind.HEIGHT:
        height_m(sensor, sensor_height_m)  # notes one that is assumed
    mapped = opened(drive)
    queried = None if query_drive is None else opened(query_drive)
    elsewhere = [opened(path) for path in unknown or ()]
    with progress_bar() as progress:
        result = evaluate_drive(mapped, protocol, queried, progress, elsewhere)
    _show(result)
    write_figures(json_out, result.as_dict())


def _show(result: Evaluation) -> None:
    of = result.drive if result.query_drive is None else f"{result.query_drive} in {result.drive}"
    how = "" if result.split is None else f", {result.split}"
    unequal = "unequal " if result.segmentation == Segmentation.UNEQUAL else ""
    show(
        f"{of}: {result.map_scans} map scans in {result.segments} {unequal}segments,"
        f" {result.encoding} {result.ranks[0]}x{result.ranks[1]},"
        f" {result.reducer} {result.image}{how}"
    )
    estimates = () if result.distance is None else _ESTIMATES
    show_conditions(result.conditions, (*_COLUMNS, *estimates, ("ms", "ms_per_query", ".1f")))
    _show_reliability(result)
    if result.tracks:
        show_conditions(result.tracks, _TRACKED, title="tracked")
    refused = sum(row.refusals for row in result.conditions)
    if refused:
        output().print(f"refused: {refused} queries, counted in no figure")
    moving = result.motion_surrogate_median_moving
    standing = result.motion_surrogate_median_standing
    if result.standing_scans is not None:
        output().print(
            f"standing: {result.standing_scans} queries; median 6-DOF change"
            f" {figure(standing, '.4f')} standing, {figure(moving, '.4f')} moving",
            soft_wrap=True,
        )
    errors = result.relative_error
    output().print(
        f"relative error {min(errors):.3f}..{max(errors):.3f}; compression"
        f" 1 : {result.compression.tensor_ratio:.1f} : {result.compression.returns_ratio:.0f},"
        f" {result.compression.elements} elements",
        soft_wrap=True,
    )
    for skipped in result.skipped:
        output().print(f"left out scan {skipped.scan}: {skipped.reason}", markup=False)


_COLUMNS = (
    ("asked", "queries", "d"),
    ("segm. right", "segment_accuracy", ".3f"),
    ("errors", "errors", "d"),
    ("moving", "errors_moving", "d"),
    ("R@1 {:g} m", "recall_at_1", ".3f"),
    ("error m", "position_error_m_median", ".2f"),
)
_ESTIMATES = (
    ("heading deg", "heading_error_deg_median", ".2f"),
    ("lateral m", "lateral_error_m_median", ".2f"),
)
_TRACKED = (
    ("seen", "observations", "d"),
    ("told", "localized", "d"),
    ("first", "first_fix", "d"),
    ("segments", "segments_told", "d"),
    ("errors", "errors", "d"),
    ("moving", "errors_moving", "d"),
    ("R@1 {:g} m", "recall_at_1", ".3f"),
    ("error m", "position_error_m_median", ".2f"),
    ("flicker", "flicker", "d"),
    ("recovery", "recovery_text", ""),
    ("ms", "ms_per_observation", ".1f"),
)
_RELIABILITY = (
    ("AUROC", "reliability.auroc", ".3f"),
    ("av. prec.", "reliability.average_precision", ".3f"),
    ("ECE", "reliability.ece", ".3f"),
    ("adapt.", "reliability.ece_adaptive", ".3f"),
    ("mixed", "reliability.ece_mixed", ".3f"),
    ("adapt.", "reliability.ece_mixed_adaptive", ".3f"),
    ("refused right", "reliability.refused_right", ".3f"),
    ("wrong", "reliability.refused_wrong", ".3f"),
    ("unknown", "reliability.refused_unknown", ".3f"),
)


def _show_reliability(result: Evaluation) -> None:
    if not result.calibrated:
        output().print("not calibrated: the map is too small to learn trust from")
        return
    checked = [(row, row.reliability) for row in result.conditions if row.reliability is not None]
    if not checked:
        return
    show_conditions([row for row, _ in checked], _RELIABILITY)
    if result.unknown_drives:
        queries = checked[0][1].unknown_queries
        show(f"unknown places: {', '.join(result.unknown_drives)}, {queries} queries")
