"""`tensormap evaluate`: how well a map of a drive answers."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from app.cli.console import output, progress_bar
from app.cli.evaluate_tracks import show_tracks
from app.cli.options import (
    MIN_RETURNS,
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
    checked,
    numbers,
    ranks,
    require_folder,
)
from core.encodings.registry import encoding_with
from core.errors import InvalidParameters
from core.evaluation.condition import conditions
from core.evaluation.evaluate import Protocol
from core.evaluation.evaluate import evaluate as evaluate_drive
from core.evaluation.result import Evaluation
from core.evaluation.split import Interleaved, parse_split
from core.parameters import MapParameters, Segmentation
from core.scans.sensor import HDL_64E
from storage.files.files import publish
from storage.formats.drives.layouts import open_drive

__all__ = ["evaluate"]

_PROTOCOL = "Protocol"


def _list_option(text: str) -> object:
    return typer.Option(
        help=f"{text}, comma-separated.", rich_help_panel=_PROTOCOL, callback=checked(numbers)
    )


def evaluate(
    drive: DriveArgument,
    query_drive: Annotated[
        Path | None,
        typer.Option(
            metavar="DRIVE2",
            help="Ask with this drive, in the same world frame; DRIVE as a whole is the map.",
            rich_help_panel=_PROTOCOL,
        ),
    ] = None,
    unknown: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="DRIVE3",
            help="Ask with this drive too, of places that are not in the map; repeatable.",
            rich_help_panel=_PROTOCOL,
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
    sensor_height_m: SensorHeightOption = 1.73,
    split: Annotated[
        str | None,
        typer.Option(
            help="interleaved:F[:PHASE] or every:N. [interleaved:0.2]", rich_help_panel=_PROTOCOL
        ),
    ] = None,
    yaw_deg: Annotated[str, _list_option("Turn the query vehicle, counter-clockwise")] = "0",
    lateral_m: Annotated[str, _list_option("Stand it so far to the left")] = "0",
    noise_m: Annotated[str, _list_option("Sigma of noise on every coordinate")] = "0",
    tolerance_m: Annotated[str, _list_option("Recall within")] = "3,5,10",
    seed: Annotated[int, typer.Option(min=0, rich_help_panel=_PROTOCOL)] = 0,
    track: Annotated[
        bool,
        typer.Option(
            "--track",
            help="Also ask them one after another, as one vehicle's drive.",
            rich_help_panel=_PROTOCOL,
        ),
    ] = False,
    json_out: Annotated[
        Path | None, typer.Option("--json", metavar="OUT", help="Write the figures here.")
    ] = None,
) -> None:
    """Build a map of one part of a drive and ask it where the other part was."""
    if json_out is not None:
        require_folder(json_out)
    if query_drive is not None and split is not None:
        raise InvalidParameters("with --query-drive all of DRIVE is the map: leave --split out")
    protocol = Protocol(
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
        split=Interleaved() if split is None else parse_split(split),
        conditions=conditions(numbers(yaw_deg), numbers(lateral_m), numbers(noise_m)),
        tolerances_m=numbers(tolerance_m),
        seed=seed,
        track=track,
    )
    mapped = open_drive(drive, min_returns=MIN_RETURNS)
    asked = None if query_drive is None else open_drive(query_drive, min_returns=MIN_RETURNS)
    elsewhere = [open_drive(path, min_returns=MIN_RETURNS) for path in unknown or ()]
    with progress_bar() as progress:
        result = evaluate_drive(mapped, protocol, asked, progress, elsewhere)
    _show(result)
    if json_out is not None:
        with publish(json_out) as part:
            part.write_text(json.dumps(result.as_dict(), indent=2, allow_nan=False))


def _show(result: Evaluation) -> None:
    of = result.drive if result.query_drive is None else f"{result.query_drive} in {result.drive}"
    how = "" if result.split is None else f", {result.split}"
    unequal = "unequal " if result.segmentation == Segmentation.UNEQUAL else ""
    output().print(
        f"{of}: {result.map_scans} map scans in {result.segments} {unequal}segments,"
        f" {result.encoding} {result.ranks[0]}x{result.ranks[1]},"
        f" {result.reducer} {result.image}{how}",
        markup=False,
        soft_wrap=True,
    )
    tolerances = list(result.conditions[0].recall_at_1)
    # No borders and short heads: all of it fits the 80 columns of a plain terminal.
    table = Table(box=SIMPLE_HEAD, padding=0)
    for heading in (
        "yaw deg",
        "left m",
        "noise m",
        "asked",
        "segm. right",
        "errors",
        "moving",
        *(f"R@1 {metres:g} m" for metres in tolerances),
        "error m",
        *(() if result.distance is None else ("heading deg", "lateral m")),
        "ms",
    ):
        table.add_column(heading, justify="right")
    for row in result.conditions:
        table.add_row(
            f"{row.condition.yaw_deg:g}",
            f"{row.condition.lateral_m:g}",
            f"{row.condition.noise_m:g}",
            str(row.queries),
            _figure(row.segment_accuracy, ".3f"),
            str(len(row.errors)),
            _figure(row.errors_moving, "d"),
            *(_figure(row.recall_at_1[metres], ".3f") for metres in tolerances),
            _figure(row.position_error_m_median, ".2f"),
            *(
                ()
                if result.distance is None
                else (
                    _figure(row.heading_error_deg_median, ".2f"),
                    _figure(row.lateral_error_m_median, ".2f"),
                )
            ),
            _figure(row.ms_per_query, ".1f"),
        )
    output().print(table)
    _show_reliability(result)
    show_tracks(result)
    refused = sum(row.refusals for row in result.conditions)
    if refused:
        output().print(f"refused: {refused} queries, counted in no figure")
    moving = result.motion_surrogate_median_moving
    standing = result.motion_surrogate_median_standing
    if result.standing_scans is not None:
        output().print(
            f"standing: {result.standing_scans} queries; median 6-DOF change"
            f" {_figure(standing, '.4f')} standing, {_figure(moving, '.4f')} moving",
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


def _show_reliability(result: Evaluation) -> None:
    if not result.calibrated:
        output().print("not calibrated: the map is too small to learn trust from")
        return
    judged = [
        (row.condition, row.reliability) for row in result.conditions if row.reliability is not None
    ]
    if not judged:
        return
    table = Table(box=SIMPLE_HEAD, padding=0)
    for heading in (
        "yaw deg",
        "left m",
        "noise m",
        "AUROC",
        "av. prec.",
        "ECE",
        "adapt.",
        "mixed",
        "adapt.",
        "refused right",
        "wrong",
        "unknown",
    ):
        table.add_column(heading, justify="right")
    for condition, of_it in judged:
        table.add_row(
            f"{condition.yaw_deg:g}",
            f"{condition.lateral_m:g}",
            f"{condition.noise_m:g}",
            _figure(of_it.auroc, ".3f"),
            _figure(of_it.average_precision, ".3f"),
            _figure(of_it.ece, ".3f"),
            _figure(of_it.ece_adaptive, ".3f"),
            _figure(of_it.ece_mixed, ".3f"),
            _figure(of_it.ece_mixed_adaptive, ".3f"),
            _figure(of_it.refused_right, ".3f"),
            _figure(of_it.refused_wrong, ".3f"),
            _figure(of_it.refused_unknown, ".3f"),
        )
    output().print(table)
    if result.unknown_drives:
        output().print(
            f"unknown places: {', '.join(result.unknown_drives)},"
            f" {judged[0][1].unknown_queries} queries",
            markup=False,
            soft_wrap=True,
        )


def _figure(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
