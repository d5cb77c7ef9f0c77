"""`tensormap compare`: our encodings and other methods on the same scans."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from app.cli import evaluation, options
from app.cli.console import figure, progress_bar, say
from app.cli.noted_drives import NotedDrives
from baselines.roster import BY_SCAN, METHODS, default_methods, methods_named
from core.errors import InvalidParameters
from core.evaluation.compare import (
    Comparison,
    ComparisonProtocol,
    MethodResult,
    MethodUnderCondition,
)
from core.evaluation.compare import compare as compare_methods
from core.evaluation.disturbances import Recording
from core.evaluation.pairing import RECENT_SCANS, HeldOut, LoopClosing, Pairing, SecondPass
from core.evaluation.truth import left_out_notes, truth_notes
from core.projection.imager import Views
from core.scans.drive import Drive
from core.scans.sensor import HDL_64E, sensor_named
from core.segmentation.fixed import segment_length_for
from core.text import count_of

_FIXED = (
    "loop", "recent_scans", "recent_s", "split", "query_every", "tolerance_m",
)  # fmt: skip
"""Options that a published protocol fixes."""


def compare(
    context: typer.Context,
    drive: options.DriveArgument,
    protocol: evaluation.FieldProtocolOption = None,
    query_drive: Annotated[
        Path | None,
        evaluation.protocol_option(
            metavar="DRIVE2",
            help="A second pass: query with this drive, in the same world frame; all of DRIVE is"
            " mapped.",
        ),
    ] = None,
    loop: Annotated[
        bool,
        evaluation.protocol_option(
            "--loop",
            help="Close loops: query with every scan among the earlier ones that are not recent.",
        ),
    ] = False,
    recent_scans: Annotated[
        int | None,
        evaluation.protocol_option(
            min=1, help=f"With --loop, how many scans earlier a place must be. [{RECENT_SCANS}]"
        ),
    ] = None,
    recent_s: Annotated[
        float | None,
        evaluation.protocol_option(
            help="With --loop, how many seconds earlier a place must be, in place of scans, for"
            " example 30."
        ),
    ] = None,
    split: evaluation.SplitOption = None,
    unknown: Annotated[
        Path | None,
        evaluation.protocol_option(
            metavar="DRIVE3", help="A drive through other places, for the novelty AUROC."
        ),
    ] = None,
    query_every: Annotated[
        int,
        evaluation.protocol_option(min=1, help="Query with every N-th scan of DRIVE2 and DRIVE3."),
    ] = 1,
    methods: Annotated[
        str | None,
        evaluation.protocol_option(
            help=f"Some of {', '.join(METHODS)}, comma-separated; of any views {', '.join(BY_SCAN)}"
            " too. [all that are installed]"
        ),
    ] = None,
    ranks_text: options.RanksOption = None,
    views: options.ViewsOption = None,
    segment_length: options.SegmentLengthOption = None,
    segments: evaluation.SegmentsOption = None,
    sensor: options.SensorOption = HDL_64E.name,
    sensor_height_m: options.SensorHeightOption = None,
    mounting: options.MountingOption = None,
    query_mounting: options.QueryMountingOption = None,
    accumulate: options.AccumulateOption = 1,
    yaw_deg: evaluation.YawOption = "0",
    lateral_m: evaluation.LateralOption = "0",
    noise_m: evaluation.NoiseOption = "0",
    disturb: evaluation.DisturbOption = "",
    tolerance_m: evaluation.ToleranceOption = "3,5,10",
    seed: evaluation.SeedOption = 0,
    json_out: evaluation.JsonOption = None,
) -> None:
    """Run other methods of place recognition on the same scans, beside ours."""
    evaluation.require_figures(json_out, drive, query_drive, unknown)
    if query_every != 1 and query_drive is None and unknown is None:
        raise InvalidParameters("--query-every is of --query-drive and --unknown")
    of_queries = evaluation.mounting_of_queries(
        query_mounting, mounting, other_drive=query_drive is not None or unknown is not None
    )
    recording = Recording(
        sensor_named(sensor),
        options.height_m(sensor, options.given_height_m(sensor_height_m, mounting)),
    )
    drives = NotedDrives(recording.height_m, accumulate)
    mapped = drives.open(drive, mounting)
    preset = evaluation.chosen_protocol(context, protocol, drive, mapped, _FIXED)
    queried: Drive | None = None
    if preset is not None:
        queried = None if query_drive is None else drives.open(query_drive, of_queries)
        prepared = preset.prepare(mapped, queried)
        mapped, queried = prepared.mapped, prepared.queried
    length = segment_length_for(
        max(1, len(mapped)), segment_length=segment_length, segments=segments
    )
    names = default_methods(views or Views.ANY)
    if methods is not None:
        names = tuple(name.strip() for name in methods.split(","))
        if "" in names:
            raise InvalidParameters(f"--methods is {methods!r}, wanted names between single commas")
    chosen = methods_named(
        names,
        sensor=sensor,
        sensor_height_m=recording.height_m,
        segment_length=length,
        ranks=options.ranks(ranks_text),
        views=views,
    )
    compared = ComparisonProtocol(
        pairing=_pairing(
            loop=loop,
            recent_scans=recent_scans,
            recent_s=recent_s,
            split=split,
            second_pass=query_drive is not None,
            every=query_every,
            segment_length=length,
        ),
        conditions=evaluation.conditions_of(yaw_deg, lateral_m, noise_m, disturb),
        tolerances_m=options.numbers(tolerance_m),
        unknown_every=query_every,
        seed=seed,
        recording=recording,
    )
    if preset is not None:
        compared = replace(
            compared,
            pairing=preset.pairing,
            tolerances_m=preset.tolerances_m,
            counting=preset.counting,
        )
    elif query_drive is not None:  # opened after the options that exclude each other are rejected
        queried = drives.open(query_drive, of_queries)
    drives.note(*left_out_notes(mapped, queried))
    if queried is not None:
        drives.note(*truth_notes(mapped, queried, max(compared.tolerances_m)))
    elsewhere = None if unknown is None else drives.open(unknown, of_queries)
    with progress_bar() as progress:
        result = compare_methods(mapped, chosen, compared, queried, elsewhere, progress)
    drives.note_equal_scans()
    if preset is not None:
        result = replace(result, protocol=str(preset))
    # First: the table may go into a pipe that is closed, or to a full disk.
    made = evaluation.of_drive(drive)
    evaluation.write_figures(json_out, made | result.as_dict() | {"notes": drives.notes})
    _show(result)


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
    """Return the protocol of the options; reject options of two protocols."""
    if loop:
        if second_pass or split is not None:
            raise InvalidParameters(
                "--loop is of one whole drive: leave --query-drive and --split out"
            )
        if recent_s is not None:
            return LoopClosing(recent_scans, recent_s)
        return LoopClosing(RECENT_SCANS if recent_scans is None else recent_scans)
    if recent_scans is not None or recent_s is not None:
        raise InvalidParameters("--recent-scans and --recent-s are of --loop")
    if second_pass:
        if split is not None:
            raise InvalidParameters("with --query-drive all of DRIVE is mapped: leave --split out")
        return SecondPass(every)
    return HeldOut(evaluation.split_of(split), segment_length)


def _show(result: Comparison) -> None:
    of = result.drive if result.query_drive is None else f"{result.query_drive} in {result.drive}"
    elsewhere = "" if result.unknown_drive is None else f"; unknown: {result.unknown_drive}"
    say(f"{of}: {result.protocol}{elsewhere}")
    first = result.methods[0]
    for column, of_first in enumerate(first.conditions):
        condition = of_first.condition
        disturbed = f", {condition.disturb}" if condition.disturb else ""
        say(
            f"\nyaw {condition.yaw_deg:g} deg, {condition.lateral_m:g} m to the left,"
            f" noise {condition.noise_m:g} m{disturbed}:"
            f" {count_of(of_first.queries, 'query', 'queries')},"
            f" {evaluation.findable_text(of_first.findable)}"
        )
        tolerances = list(of_first.recall_at_1)
        evaluation.show_table(
            (
                "method",
                *(f"R@1 {metres:g} m" for metres in tolerances),
                f"F1 {tolerances[0]:g} m",
                f"AP {tolerances[0]:g} m",
                *("AUROC", "turn deg", "B sent", "B kept", "ms desc.", "ms match"),
            ),
            [_cells(method, method.conditions[column], tolerances) for method in result.methods],
            named=True,
        )
        for method in result.methods:
            row = method.conditions[column]
            if row.refusals or row.unanswered:
                say(
                    f"{method.name}: {count_of(row.refusals, 'query', 'queries')} not"
                    f" described, {row.unanswered} without an answer"
                )
    say(
        "F1: the greatest over all thresholds. AP: average precision, the area under precision over"
        " recall by steps. Milliseconds: medians of processor time, one thread."
    )


def _cells(method: MethodResult, row: MethodUnderCondition, tolerances: list[float]) -> list[str]:
    first = tolerances[0]
    shares = [*row.recall_at_1.values(), row.max_f1[first], row.average_precision[first]]
    return [
        method.name,
        *(figure(share, ".3f") for share in (*shares, row.novelty_auroc)),
        figure(row.heading_error_deg_median, ".1f"),
        figure(method.sent_bytes, ".0f"),
        figure(method.stored_bytes, ".0f"),
        figure(row.describe_ms_median, ".1f"),
        figure(row.match_ms_median, ".2f"),
    ]
