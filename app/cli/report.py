"""`tensormap report`: the paper's figures for one's own drive, and advice on {r1, r2, k}."""

from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from app import provenance
from app.cli import evaluation, options
from app.cli.console import progress_bar, say
from app.cli.noted_drives import NotedDrives
from app.cli.output_files import require_apart, require_folder, written
from core.encodings.registry import encoding_names
from core.evaluation.study import Study
from core.evaluation.study_drive import StudyProtocol, study_drive
from core.parameters import MapParameters
from core.scans.sensor import HDL_64E

_tried: Any = partial(typer.Option, rich_help_panel="What is tried")


def _sizes(text: str | None) -> tuple[int, ...]:
    """Read a comma-separated list of whole numbers above 0; none without a text."""
    parts = [part.strip() for part in text.split(",")] if text is not None else []
    if not all(part.isdecimal() and int(part) > 0 for part in parts):
        raise typer.BadParameter(f"{text!r} is no comma-separated list of whole numbers above 0")
    return tuple(map(int, parts))


def _sizes_option(text: str) -> Any:  # noqa: ANN401 - Typer's own type
    return _tried(help=text, callback=options.checked(_sizes))


def report(
    drive: options.DriveArgument,
    out: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="REPORT.html", help="The page to write; it is replaced."
        ),
    ],
    encoding: Annotated[
        list[str] | None,
        _tried(metavar="|".join(encoding_names()), help="One encoding; both without it."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer candidates, 60 queries.")] = False,
    max_bytes_per_scan: Annotated[
        float | None,
        typer.Option(min=1.0, help="Largest map to recommend, in bytes a scan."),
    ] = None,
    r1: Annotated[str | None, _sizes_option("r1 that are tried. [2,3,4,5,6,8,10,15,25]")] = None,
    r2: Annotated[str | None, _sizes_option("r2 that are tried. [2,3,4,5,6,8,10,15,25]")] = None,
    k: Annotated[
        str | None,
        _sizes_option("k that are tried, in scans. [for about 20, 12, 8, 5 and 2 segments]"),
    ] = None,
    ranks_text: Annotated[
        str | None,
        _tried(
            "--ranks",
            help="r1,r2 whose answers are shown, instead of the recommended ones.",
            callback=options.checked(options.ranks),
        ),
    ] = None,
    segment_length: Annotated[
        int | None, _tried(min=1, help="k whose answers are shown, instead of the recommended one.")
    ] = None,
    split: evaluation.SplitOption = None,
    max_queries: Annotated[
        int | None, typer.Option(min=1, help="Largest number of queries. [200; quick: 60]")
    ] = None,
    sensor: options.SensorOption = HDL_64E.name,
    sensor_height_m: options.SensorHeightOption = None,
    mounting: options.MountingOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the noise.")] = 0,
    json_out: evaluation.JsonOption = None,
) -> None:
    """Redraw the paper's figures for a drive, and recommend {r1, r2, k}."""
    _require_drawing()
    require_folder(out)
    require_apart(out, drive)
    evaluation.require_figures(json_out, drive, out)
    above_ground_m = options.height_m(sensor, options.given_height_m(sensor_height_m, mounting))
    protocol = StudyProtocol(
        parameters=tuple(
            MapParameters.for_sensor(sensor, encoding=each, sensor_height_m=above_ground_m)
            for each in dict.fromkeys(encoding or encoding_names())
        ),
        max_queries=max_queries or (60 if quick else 200),
        ranks=options.ranks(ranks_text),
        segment_length=segment_length,
        segment_lengths=_sizes(k) or None,
        split=evaluation.split_of(split),
        max_bytes_per_scan=max_bytes_per_scan,
        seed=seed,
    )
    if quick:
        protocol = replace(
            protocol,
            r1=(3, 5, 8),
            r2=(3, 5, 8),
            noise_m=(0.0, 0.2, 1.0),
            lateral_m=(-2.0, 0.0, 2.0),
            yaw_deg=(0.0, 10.0, 180.0),
        )
    protocol = replace(protocol, r1=_sizes(r1) or protocol.r1, r2=_sizes(r2) or protocol.r2)
    drives = NotedDrives(above_ground_m)
    recorded = drives.open(drive, mounting)
    from app.report.page import render_report  # here: it needs the extra, and a second to load

    with progress_bar() as progress:
        study = study_drive(recorded, protocol, progress)
    drives.note_equal_scans()
    with progress_bar() as progress:
        made = provenance.of_report()
        page = render_report(study, made, progress, drives.notes)
    with written(out) as part:
        part.write_text(page, encoding="utf-8")
    figures = study.as_dict() | {"made": made, "notes": drives.notes}
    evaluation.write_figures(json_out, figures, indent=None)
    _show(study, out)


def _require_drawing() -> None:
    """Raise `typer.BadParameter`, before the long work, if what draws the page is missing."""
    missing = [name for name in ("matplotlib", "jinja2") if find_spec(name) is None]
    if missing:
        raise typer.BadParameter(
            f"a report needs {' and '.join(missing)}: pip install -e clients/python -e '.[report]'"
            " in a clone"
        )


def _show(study: Study, out: Path) -> None:
    for studied in study.encodings:
        best = studied.advice.recommended
        named = "no candidate fits"
        if best is not None:
            named = f"r1 = {best.ranks[0]}, r2 = {best.ranks[1]}, k = {best.segment_length}"
        say(f"{studied.name}: {named} ({studied.advice.decision.value.replace('_', ' ')})")
        for reason in studied.advice.reasons:
            say(f"  {reason}")
    say(f"{out}: written")
