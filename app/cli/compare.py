"""`tensormap compare`: our encodings and other methods on the same scans."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from app.baselines.roster import METHODS, default_methods, methods_named
from app.cli.console import output, progress_bar
from app.cli.options import (
    MIN_RETURNS,
    DriveArgument,
    SegmentLengthOption,
    SegmentsOption,
    SensorHeightOption,
    SensorOption,
    checked,
    numbers,
    require_folder,
)
from app.provenance import provenance
from core.errors import InvalidParameters
from core.evaluation.compare import ComparisonProtocol
from core.evaluation.compare import compare as compare_methods
from core.evaluation.comparison import Comparison, MethodUnderCondition
from core.evaluation.condition import conditions
from core.evaluation.pairing import RECENT_SCANS, HeldOut, LoopClosing, Pairing, SecondPass
from core.evaluation.split import Interleaved, parse_split
from core.scans.drive import Drive
from core.scans.sensor import HDL_64E
from core.segmentation import segment_length_for
from storage.files.files import publish
from storage.formats.drives.layouts import open_drive

__all__ = ["compare"]

_PROTOCOL = "Protocol"


def _list_option(text: str) -> object:
    return typer.Option(
        help=f"{text}, comma-separated.", rich_help_panel=_PROTOCOL, callback=checked(numbers)
    )


def compare(
    drive: DriveArgument,
    query_drive: Annotated[
        Path | None,
        typer.Option(
            metavar="DRIVE2",
            help="A second pass: ask with this drive, in the same world frame; all of DRIVE is"
            " mapped.",
            rich_help_panel=_PROTOCOL,
        ),
    ] = None,
    loop: Annotated[
        bool,
        typer.Option(
            "--loop",
            help="Close loops: ask every scan among the earlier ones that are not recent.",
            rich_help_panel=_PROTOCOL,
        ),
    ] = False,
    recent_scans: Annotated[
        int | None,
        typer.Option(
            min=1,
            help=f"With --loop, how many scans earlier a place must be. [{RECENT_SCANS}]",
            rich_help_panel=_PROTOCOL,
        ),
    ] = None,
    recent_s: Annotated[
        float | None,
        typer.Option(
            help="With --loop, how many seconds instead, for example 30.",
            rich_help_panel=_PROTOCOL,
        ),
    ] = None,
    split: Annotated[
        str | None,
        typer.Option(
            help="interleaved:F[:PHASE] or every:N. [interleaved:0.2]", rich_help_panel=_PROTOCOL
        ),
    ] = None,
    unknown: Annotated[
        Path | None,
        typer.Option(
            metavar="DRIVE3",
            help="A drive through other places, for the novelty AUROC.",
            rich_help_panel=_PROTOCOL,
        ),
    ] = None,
    query_every: Annotated[
        int,
        typer.Option(
            min=1, help="Ask each so-manieth scan of DRIVE2 and DRIVE3.", rich_help_panel=_PROTOCOL
        ),
    ] = 1,
    methods: Annotated[
        str | None,
        typer.Option(
            help=f"Some of {','.join(METHODS)}. [all that are installed]",
            rich_help_panel=_PROTOCOL,
        ),
    ] = None,
    segment_length: SegmentLengthOption = None,
    segments: SegmentsOption = None,
    sensor: SensorOption = HDL_64E.name,
    sensor_height_m: SensorHeightOption = 1.73,
    yaw_deg: Annotated[str, _list_option("Turn the query vehicle, counter-clockwise")] = "0",
    lateral_m: Annotated[str, _list_option("Stand it so far to the left")] = "0",
    noise_m: Annotated[str, _list_option("Sigma of noise on every coordinate")] = "0",
    tolerance_m: Annotated[str, _list_option("An answer is right within")] = "3,5,10",
    seed: Annotated[int, typer.Option(min=0, rich_help_panel=_PROTOCOL)] = 0,
    json_out: Annotated[
        Path | None, typer.Option("--json", metavar="OUT", help="Write the figures here.")
    ] = None,
) -> None:
    """Run other methods of place recognition on the same scans, beside ours."""
    if json_out is not None:
        require_folder(json_out)
    mapped = open_drive(drive, min_returns=MIN_RETURNS)
    length = segment_length_for(
        max(1, len(mapped)), segment_length=segment_length, segments=segments
    )
    names = default_methods() if methods is None else tuple(methods.split(","))
    chosen = methods_named(
        names, sensor=sensor, sensor_height_m=sensor_height_m, segment_length=length
    )
    protocol = ComparisonProtocol(
        pairing=_pairing(
            loop=loop,
            recent_scans=recent_scans,
            recent_s=recent_s,
            split=split,
            second_pass=query_drive is not None,
            every=query_every,
            segment_length=length,
        ),
        conditions=conditions(numbers(yaw_deg), numbers(lateral_m), numbers(noise_m)),
        tolerances_m=numbers(tolerance_m),
        unknown_every=query_every,
        seed=seed,
    )
    with progress_bar() as progress:
        result = compare_methods(
            mapped, chosen, protocol, _opened(query_drive), _opened(unknown), progress
        )
    _show(result)
    if json_out is not None:
        figures = {"provenance": provenance(), "data": str(drive), **result.as_dict()}
        with publish(json_out) as part:
            part.write_text(json.dumps(figures, indent=2, allow_nan=False))


def _opened(path: Path | None) -> Drive | None:
    return None if path is None else open_drive(path, min_returns=MIN_RETURNS)


def _pairing(
    *,
    loop: bool,
    recent_scans: int | None,
    recent_s: float | None,
    split: str | None,
    second_pass: bool,
    every: int,
    segment_length: int,
) -> Pairing:
    """Return the protocol that the options ask for, refusing those of two at once."""
    if loop:
        if second_pass or split is not None:
            raise InvalidParameters(
                "--loop is of one drive, whole: leave --query-drive and --split"
            )
        if recent_s is not None:
            return LoopClosing(recent_scans, recent_s)
        return LoopClosing(RECENT_SCANS if recent_scans is None else recent_scans)
    if recent_scans is not None or recent_s is not None:
        raise InvalidParameters("--recent-scans and --recent-s are of --loop")
    if second_pass:
        if split is not None:
            raise InvalidParameters("with --query-drive all of DRIVE is the map: leave --split out")
        return SecondPass(every)
    return HeldOut(Interleaved() if split is None else parse_split(split), segment_length)


def _show(result: Comparison) -> None:
    of = result.drive if result.query_drive is None else f"{result.query_drive} in {result.drive}"
    elsewhere = "" if result.unknown_drive is None else f"; unknown: {result.unknown_drive}"
    output().print(f"{of}: {result.protocol}{elsewhere}", markup=False, soft_wrap=True)
    first = result.methods[0]
    for column, of_first in enumerate(first.conditions):
        condition = of_first.condition
        findable = ", ".join(f"{count} within {m:g} m" for m, count in of_first.findable.items())
        output().print(
            f"\nyaw {condition.yaw_deg:g} deg, {condition.lateral_m:g} m to the left,"
            f" noise {condition.noise_m:g} m: {of_first.queries} asked, findable {findable}",
            soft_wrap=True,
        )
        tolerances = list(of_first.recall_at_1)
        table = Table(box=SIMPLE_HEAD, padding=0)
        table.add_column("method", no_wrap=True)
        for heading in (
            *(f"R@1 {metres:g} m" for metres in tolerances),
            f"F1 {tolerances[0]:g} m",
            f"AP {tolerances[0]:g} m",
            "AUROC",
            "turn deg",
            "B sent",
            "B kept",
            "ms desc.",
            "ms match",
        ):
            table.add_column(heading, justify="right")
        for method in result.methods:
            row = method.conditions[column]
            table.add_row(
                method.name,
                *_shares(row, tolerances),
                _figure(row.novelty_auroc, ".3f"),
                _figure(row.heading_error_deg_median, ".1f"),
                _figure(method.sent_bytes, ".0f"),
                _figure(method.stored_bytes, ".0f"),
                _figure(row.describe_ms_median, ".1f"),
                _figure(row.match_ms_median, ".2f"),
            )
        output().print(table)
    output().print(
        "F1: the greatest over all thresholds. AP: average precision, the area under precision over"
        " recall by steps. Milliseconds: medians of processor time, one thread.",
        soft_wrap=True,
    )
    refused = [(method.name, row) for method in result.methods for row in method.conditions]
    for name, row in refused:
        if row.refusals or row.unanswered:
            output().print(
                f"{name}: {row.refusals} queries not described, {row.unanswered} without an answer",
                soft_wrap=True,
            )


def _shares(row: MethodUnderCondition, tolerances: list[float]) -> list[str]:
    first = tolerances[0]
    shares = [row.recall_at_1[metres] for metres in tolerances]
    return [
        _figure(share, ".3f")
        for share in (*shares, row.max_f1[first], row.average_precision[first])
    ]


def _figure(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
