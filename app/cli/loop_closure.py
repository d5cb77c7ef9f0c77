"""`tensormap loop-closure`: checks of proposed closures between scans of drives."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from rich.table import Table

from app.cli.console import show
from app.cli.options import DriveArgument, MountingOption, open_mapped
from app.cli.queries import answers_to, report_unusable, write_answer
from app.loop_closures.schemas import LoopClosureOut
from core.errors import InvalidParameters
from core.loop_closure.closure import ACCEPT_FROM, LoopClosure, check_scans
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
    """Check proposed loop closures by the returns of both scans.

    Pairs with an unusable scan are reported, the others are answered. In JSON `query` is the pair
    that an answer is of.
    """
    proposed = [_pair(text) for text in pairs]
    recorded = open_mapped(drive, mounting, sensor_height_m)
    other = recorded
    if second_drive is not None:
        other = open_mapped(second_drive, mounting, sensor_height_m)
    for first, second in proposed:
        _require_scan(recorded, first)
        _require_scan(other, second)
    names = (recorded.name, other.name)
    if second_drive is not None and recorded.name == other.name:
        names = (str(drive), str(second_drive))

    def checked(pair: tuple[int, int]) -> _Checked:
        first, second = pair
        found = check_scans(recorded.scan(first), other.scan(second), sensor_height_m)
        shown = LoopClosureOut.from_core(found, accept_from)
        return _Checked(f"{names[0]} {first}", f"{names[1]} {second}", found, shown)

    def written_at_once(name: str, one: _Checked) -> None:
        write_answer(name, one.shown)

    queries = [
        (f"{names[0]} {first}, {names[1]} {second}", (first, second)) for first, second in proposed
    ]
    answers, unusable = answers_to(
        queries, checked, written_at_once if as_json else None, stage="checking"
    )
    if answers:
        _show([one for _, one in answers])
    report_unusable(unusable)


class _Checked(NamedTuple):
    """The names of two scans, and the result of their check."""

    first: str
    second: str
    found: LoopClosure
    shown: LoopClosureOut


def _show(answers: Sequence[_Checked]) -> None:
    table = Table("first", "second", "decision", "probability", "turn deg", "ahead m", "left m")
    for first, second, found, shown in answers:
        table.add_row(
            first,
            second,
            shown.verdict.value,
            f"{found.probability:.3f}",
            f"{found.relative_yaw_deg:.0f}",
            f"{found.forward_m:.1f}",
            f"{found.lateral_m:.1f}",
        )
    show(table, names=("first", "second"))


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
