"""`tensormap loop-closure`: checks of proposed closures between scans of drives."""

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.cli.console import progress_bar, show
from app.cli.options import DriveArgument, MountingOption, open_mapped
from app.loop_closures.schemas import LoopClosureOut
from core.errors import InvalidParameters
from core.loop_closure.closure import ACCEPT_FROM, check_scans
from core.scans.drive import Drive
from core.scans.sensor import HDL_64E_ON_KITTI_HEIGHT_M


def loop_closure(
    drive: DriveArgument,
    pairs: Annotated[
        list[str], typer.Argument(help="Pairs of scans, counted from 0.", metavar="I,J...")
    ],
    second_drive: Annotated[
        Path | None,
        typer.Option(metavar="DRIVE", help="The drive of the second scans, if it is another."),
    ] = None,
    sensor_height_m: Annotated[
        float,
        typer.Option(min=0.01, max=99.99, help="Height of the sensor above ground, in metres."),
    ] = HDL_64E_ON_KITTI_HEIGHT_M,
    mounting: MountingOption = None,
    accept_from: Annotated[
        float, typer.Option(min=0.501, max=1.0, help="Lowest probability to accept.")
    ] = ACCEPT_FROM,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON answer a line.")] = False,
) -> None:
    """Check proposed loop closures by the returns of both scans."""
    proposed = [_pair(text) for text in pairs]
    recorded = open_mapped(drive, mounting, sensor_height_m)
    other = recorded
    if second_drive is not None:
        other = open_mapped(second_drive, mounting, sensor_height_m)
    for first, second in proposed:
        _require_scan(recorded, first)
        _require_scan(other, second)
    table = Table("first", "second", "verdict", "probability", "turn deg", "ahead m", "left m")
    try:
        with progress_bar() as progress:
            progress.start("checking", len(proposed))
            for first, second in proposed:
                found = check_scans(recorded.scan(first), other.scan(second), sensor_height_m)
                shown = LoopClosureOut.from_core(found, accept_from)
                progress.advance()
                if as_json:
                    sys.stdout.write(f"{shown.model_dump_json()}\n")
                    continue
                table.add_row(
                    f"{recorded.name} {first}",
                    f"{other.name} {second}",
                    shown.verdict.value,
                    f"{found.probability:.3f}",
                    f"{found.relative_yaw_deg:.0f}",
                    f"{found.forward_m:.1f}",
                    f"{found.lateral_m:.1f}",
                )
    finally:  # also what was found before a scan that cannot be used
        if table.row_count:
            show(table)


def _require_scan(drive: Drive, index: int) -> None:
    if index >= len(drive):
        raise InvalidParameters(
            f"drive {drive.name} has no scan {index}, it has 0..{len(drive) - 1}"
        )


def _pair(text: str) -> tuple[int, int]:
    """Read `I,J`.

    Raises:
        InvalidParameters: If it is something else.

    Examples:
        >>> _pair("3,47")
        (3, 47)
    """
    first, comma, second = (part.strip() for part in text.partition(","))
    if not (comma and first.isdecimal() and second.isdecimal()):
        raise InvalidParameters(f"{text!r} is no pair of scans I,J")
    return int(first), int(second)
