"""`tensormap report`: the paper's figures for one's own drive, and advice on {r1, r2, k}."""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from app.cli.console import output, progress_bar
from app.cli.evaluation import JsonOption, SplitOption, opened, split_of, write_figures
from app.cli.options import (
    DriveArgument,
    SensorHeightOption,
    SensorOption,
    checked,
    height_m,
    ranks,
    require_folder,
)
from app.report.provenance import provenance
from core.encodings.registry import encoding_names
from core.evaluation.study import Study
from core.evaluation.study_drive import StudyProtocol, study_drive
from core.parameters import MapParameters
from core.scans.sensor import HDL_64E
from storage.files.files import publish

_PANEL = "What is tried"
_NEEDED = ("matplotlib", "jinja2")


def _ranks_tried(text: str) -> tuple[int, ...]:
    """Read a comma-separated list of whole numbers above 0."""
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and int(part) > 0 for part in parts):
        raise typer.BadParameter(f"{text!r} is no comma-separated list of whole numbers above 0")
    return tuple(map(int, parts))


def _tried(text: str) -> object:
    return typer.Option(help=text, rich_help_panel=_PANEL, callback=_checked_if_given)


def _checked_if_given(text: str | None) -> str | None:
    return None if text is None else checked(_ranks_tried)(text)


def report(
    drive: DriveArgument,
    out: Annotated[
        Path, typer.Option("--output", "-o", metavar="REPORT.html", help="The page to write.")
    ],
    encoding: Annotated[
        list[str] | None,
        typer.Option(
            metavar="|".join(encoding_names()),
            help="One of them; both without it.",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer candidates, 60 scans asked.")
    ] = False,
    max_bytes_per_scan: Annotated[
        float | None,
        typer.Option(min=1.0, help="Recommend nothing whose map is larger, for each scan."),
    ] = None,
    r1: Annotated[str | None, _tried("r1 that are tried. [2,3,4,5,6,8,10,15,25]")] = None,
    r2: Annotated[str | None, _tried("r2 that are tried. [2,3,4,5,6,8,10,15,25]")] = None,
    k: Annotated[
        str | None, _tried("k that are tried, in scans. [for about 20, 12, 8, 5 and 2 segments]")
    ] = None,
    ranks_text: Annotated[
        str | None,
        typer.Option(
            "--ranks",
            help="r1,r2 whose answers are shown, instead of the recommended ones.",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    segment_length: Annotated[
        int | None,
        typer.Option(min=1, help="k whose answers are shown, likewise.", rich_help_panel=_PANEL),
    ] = None,
    split: SplitOption = None,
    max_questions: Annotated[
        int | None, typer.Option(min=1, help="Ask at most so many scans. [200; quick: 60]")
    ] = None,
    sensor: SensorOption = HDL_64E.name,
    sensor_height_m: SensorHeightOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the noise.")] = 0,
    json_out: JsonOption = None,
) -> None:
    """Redraw the paper's figures for a drive, and recommend {r1, r2, k}."""
    _require_drawing()
    for path in (out, *([] if json_out is None else [json_out])):
        require_folder(path)
    above_ground_m = height_m(sensor, sensor_height_m)
    protocol = StudyProtocol(
        parameters=tuple(
            MapParameters.for_sensor(sensor, encoding=each, sensor_height_m=above_ground_m)
            for each in dict.fromkeys(encoding or encoding_names())
        ),
        max_queries=max_questions or (60 if quick else 200),
        ranks=None if ranks_text is None else ranks(ranks_text),
        segment_length=segment_length,
        split=split_of(split),
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
    protocol = replace(
        protocol,
        r1=protocol.r1 if r1 is None else _ranks_tried(r1),
        r2=protocol.r2 if r2 is None else _ranks_tried(r2),
        segment_lengths=None if k is None else _ranks_tried(k),
    )
    recorded = opened(drive)
    from app.report.page import render_report  # here: it needs the extra, and a second to load

    with progress_bar() as progress:
        study = study_drive(recorded, protocol, progress)
        made = provenance()
        page = render_report(study, made, progress)
    with publish(out) as part:
        part.write_text(page, encoding="utf-8")
    write_figures(json_out, study.as_dict() | {"made": made}, indent=None)
    _show(study, out)


def _require_drawing() -> None:
    """Refuse before the long work, not after it.

    Raises:
        typer.BadParameter: If what draws the page is not installed.
    """
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        raise typer.BadParameter(
            f"a report needs {' and '.join(missing)}: pip install '.[report]' in a clone"
        )


def _show(study: Study, out: Path) -> None:
    for of in study.encodings:
        best = of.advice.recommended
        named = (
            "no candidate fits"
            if best is None
            else f"r1 = {best.ranks[0]}, r2 = {best.ranks[1]}, k = {best.segment_length}"
        )
        output().print(
            f"{of.parameters.encoding}: {named} ({of.advice.verdict.value.replace('_', ' ')})",
            markup=False,
            highlight=False,
        )
        for reason in of.advice.reasons:
            output().print(f"  {reason}", markup=False, highlight=False, soft_wrap=True)
    output().print(f"{out}: written", markup=False, highlight=False, soft_wrap=True)
