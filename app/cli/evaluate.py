"""`tensormap evaluate`: how well a map of a drive answers."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from app.builds.calibration_notes import not_calibrated
from app.cli import evaluation, options
from app.cli.console import figure, progress_bar, say, say_note
from app.cli.noted_drives import NotedDrives
from core.encodings.registry import encoding_named, encoding_with
from core.errors import InvalidParameters
from core.evaluation.evaluate import Evaluation, EvaluationProtocol
from core.evaluation.evaluate import evaluate as evaluate_drive
from core.evaluation.protocol import FieldProtocol, findable
from core.evaluation.truth import truth_notes, uncounted_notes
from core.parameters import MapParameters, Segmentation
from core.projection.imager import ImageKind
from core.scans.drive import Drive
from core.scans.sensor import HDL_64E
from core.text import count_of
from storage.files.file_buffer import FileBuffer


def evaluate(
    context: typer.Context,
    drive: options.DriveArgument,
    protocol: evaluation.FieldProtocolOption = None,
    query_drive: Annotated[
        Path | None,
        evaluation.protocol_option(
            metavar="DRIVE2",
            help="Query with this drive, in the same world frame; DRIVE as a whole is the map.",
        ),
    ] = None,
    unknown: Annotated[
        list[Path] | None,
        evaluation.protocol_option(
            metavar="DRIVE3",
            help="Query with this drive too, of places that are not in the map; repeatable.",
        ),
    ] = None,
    encoding: options.EncodingOption = None,
    ranks_text: options.RanksOption = None,
    segmentation: options.SegmentationOption = Segmentation.FIXED,
    views: options.ViewsOption = None,
    verification_images: options.VerificationOption = None,
    segment_length: options.SegmentLengthOption = None,
    segments: evaluation.SegmentsOption = None,
    reducer: options.ReducerOption = None,
    image: options.ImageOption = None,
    distance: options.DistanceOption = None,
    lateral_renderings: options.LateralRenderingsOption = None,
    sensor: options.SensorOption = HDL_64E.name,
    sensor_height_m: options.SensorHeightOption = None,
    mounting: options.MountingOption = None,
    query_mounting: options.QueryMountingOption = None,
    accumulate: options.AccumulateOption = 1,
    split: evaluation.SplitOption = None,
    yaw_deg: evaluation.YawOption = "0",
    lateral_m: evaluation.LateralOption = "0",
    noise_m: evaluation.NoiseOption = "0",
    disturb: evaluation.DisturbOption = "",
    tolerance_m: evaluation.ToleranceOption = "3,5,10",
    seed: evaluation.SeedOption = 0,
    track: Annotated[
        bool,
        evaluation.protocol_option(
            "--track", help="Also track the queries, as one vehicle's drive."
        ),
    ] = False,
    json_out: evaluation.JsonOption = None,
) -> None:
    """Build a map of one part of a drive and query it with the other part."""
    evaluation.require_figures(json_out, drive, query_drive, *(unknown or ()))
    if query_drive is not None and split is not None:
        raise InvalidParameters("with --query-drive all of DRIVE is mapped: leave --split out")
    of_queries = evaluation.mounting_of_queries(
        query_mounting, mounting, other_drive=query_drive is not None or bool(unknown)
    )
    height_m = options.given_height_m(sensor_height_m, mounting)
    evaluated = EvaluationProtocol(
        parameters=MapParameters.for_sensor(
            sensor,
            encoding=encoding or encoding_with(reducer),
            ranks=options.ranks(ranks_text),
            reducer=reducer,
            sensor_height_m=height_m,
            image=image,
            distance=distance,
            lateral_renderings_m=(
                None if lateral_renderings is None else options.numbers(lateral_renderings)
            ),
            segmentation=segmentation,
            views=views,
            verification_images=verification_images,
        ),
        segment_length=segment_length,
        segments=segments,
        split=evaluation.split_of(split),
        conditions=evaluation.conditions_of(yaw_deg, lateral_m, noise_m, disturb),
        tolerances_m=options.numbers(tolerance_m),
        seed=seed,
        track=track,
    )
    if evaluated.parameters.image == ImageKind.HEIGHT:
        options.height_m(sensor, height_m)  # notes one that is assumed
    drives = NotedDrives(evaluated.parameters.sensor_height_m, accumulate)
    mapped = drives.open(drive, mounting)
    queried = None if query_drive is None else drives.open(query_drive, of_queries)
    drives.note(*uncounted_notes(mapped, queried))
    preset = evaluation.chosen_protocol(context, protocol, drive, mapped, ("split", "tolerance_m"))
    if preset is not None:
        mapped, queried = _prepared(preset, mapped, queried)
        within_m = preset.tolerances_m
        evaluated = replace(evaluated, tolerances_m=tuple(m for m in within_m if m >= within_m[0]))
    drives.note(*truth_notes(mapped, queried, max(evaluated.tolerances_m)))
    elsewhere = [drives.open(path, of_queries) for path in unknown or ()]
    with progress_bar() as progress:
        result = evaluate_drive(mapped, evaluated, queried, progress, elsewhere, FileBuffer)
    drives.note_equal_scans()
    made = evaluation.of_drive(drive) | ({} if preset is None else {"protocol": str(preset)})
    # First: the table may go into a pipe that is closed, or to a full disk.
    evaluation.write_figures(json_out, made | result.as_dict() | {"notes": drives.notes})
    _show(result)


def _prepared(preset: FieldProtocol, mapped: Drive, queried: Drive | None) -> tuple[Drive, Drive]:
    """Return what is mapped and the queries that recall counts, and print how many there are."""
    prepared = preset.prepare(mapped, queried)
    if prepared.queried is None:
        raise InvalidParameters(
            f"{preset.name} closes loops, each query among the places before it, which a map that"
            f" is built once does not: use `tensormap compare --protocol {preset.name}`"
        )
    counted = findable(prepared.mapped, prepared.queried, preset.tolerances_m[0])
    say(
        f"{preset}\n{count_of(len(prepared.mapped), 'place')},"
        f" {count_of(len(prepared.queried), 'query', 'queries')}, of which"
        f" {len(counted)} have a place within {preset.tolerances_m[0]:g} m and count"
    )
    return prepared.mapped, counted


def _show(result: Evaluation) -> None:
    of = result.drive if result.query_drive is None else f"{result.query_drive} in {result.drive}"
    how = "" if result.split is None else f", {result.split}"
    unequal = "unequal " if result.segmentation == Segmentation.UNEQUAL else ""
    say(
        f"{of}: {count_of(result.map_scans, 'map scan')} in"
        f" {count_of(result.segments, f'{unequal}segment')},"
        f" {result.encoding} {result.ranks[0]}x{result.ranks[1]},"
        f" {result.reducer} {result.image}{how}"
    )
    estimates = _ESTIMATES if encoding_named(result.encoding).yaw_invariant else ()
    evaluation.show_conditions(
        result.conditions, (*_COLUMNS, *estimates, ("ms", "ms_per_query", ".1f"))
    )
    _show_findable(result)
    _show_reliability(result)
    if result.tracks:
        evaluation.show_conditions(result.tracks, _TRACKED, title="tracked")
    unusable = sum(row.refusals for row in result.conditions)
    if unusable:
        queries = sum(row.queries for row in result.conditions)
        say(
            f"unusable: {unusable} of {count_of(queries, 'query', 'queries')}, in no figure but"
            " their number"
        )
    if result.standing_scans is not None:
        medians = [
            f"{figure(median, '.4f')} {state}"
            for median, state in (
                (result.motion_surrogate_median_standing, "standing"),
                (result.motion_surrogate_median_moving, "moving"),
            )
            if median is not None
        ]
        change = "median change in 6-DOF pose (m and rad) since the scan before"
        say(
            f"standing: {count_of(result.standing_scans, 'query', 'queries')}"
            + (f"; {change} {', '.join(medians)}" if medians else "")
        )
    errors = result.relative_error
    verification = options.of_verification(result.compression.verification_bytes)
    say(
        f"relative error {min(errors):.3f}..{max(errors):.3f};"
        f" {options.ratios(result.compression)} in numbers,"
        f" {result.compression.elements} elements{verification}"
    )
    for skipped in result.skipped:
        say_note(f"left out scan {skipped.scan}: {skipped.reason}")


_COLUMNS = (
    ("queries", "queries", "d"),
    ("segment right", "segment_accuracy", ".3f"),
    ("errors", "errors", "d"),
    ("moving", "errors_moving", "d"),
    ("same place", "errors_same_place", "d"),
    ("R@1 {:g} m", "recall_at_1", ".3f"),
    ("error m", "position_error_m_median", ".2f"),
    ("to scan m", "nearest_scan_m_median", ".2f"),
)
_ESTIMATES = (
    ("heading deg", "heading_error_deg_median", ".2f"),
    ("lateral m", "lateral_error_m_median", ".2f"),
)
_TRACKED = (
    ("obs.", "observations", "d"),
    ("found", "localized", "d"),
    ("first", "first_fix", "d"),
    ("segments", "segments_reported", "d"),
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
    ("even bins", "reliability.ece_adaptive", ".3f"),
    ("mixed ECE", "reliability.ece_mixed", ".3f"),
    ("mixed, even bins", "reliability.ece_mixed_adaptive", ".3f"),
    ("refused right", "reliability.refused_right", ".3f"),
    ("wrong", "reliability.refused_wrong", ".3f"),
    ("unknown", "reliability.refused_unknown", ".3f"),
)


def _show_findable(result: Evaluation) -> None:
    """Print of how many queries recall is: of those with an answer, once where they are as many."""
    lines = {
        f"{count_of(row.queries - row.refusals, 'answered query', 'answered queries')},"
        f" {evaluation.findable_text(row.findable)}": None
        for row in result.conditions
        if any(row.findable.values())
    }
    for line in lines:
        say(line)


def _show_reliability(result: Evaluation) -> None:
    if not result.calibrated:
        say(not_calibrated("query"))
        return
    checked = [(row, row.reliability) for row in result.conditions if row.reliability is not None]
    if not checked:
        return
    evaluation.show_conditions([row for row, _ in checked], _RELIABILITY)
    say(
        "ECE: mean difference of probability and share of right answers over ten bins; even: of"
        " equal count; mixed: known and unknown places count half each"
    )
    if any(of_row.off_map_queries for _, of_row in checked):
        known, left_out = checked[0][1].known_queries, checked[0][1].off_map_queries
        within_m = max(checked[0][0].findable)
        say(
            f"known places: {count_of(known, 'query', 'queries')}; {left_out} without a map scan"
            f" within {within_m:g} m left out"
        )
    if result.unknown_drives:
        queries = checked[0][1].unknown_queries
        asked = count_of(queries, "query", "queries")
        say(f"unknown places: {', '.join(result.unknown_drives)}, {asked}")
