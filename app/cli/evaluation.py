"""Shared by the commands of evaluation: options, drives, tables and files of figures."""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from app.cli.console import figure, output, say, show
from app.cli.options import checked, numbers
from app.cli.output_files import require_apart, require_file_or_stream, written
from app.provenance import provenance
from core.errors import InvalidParameters
from core.evaluation.condition import Condition, conditions
from core.evaluation.disturbances import DISTURBANCES, parse_disturbances
from core.evaluation.protocol import (
    FIELD_PROTOCOLS,
    KITTI,
    KITTI_SCANS,
    FieldProtocol,
    field_protocol,
)
from core.evaluation.revisits import KNOWN_REVISITS, revisits
from core.evaluation.split import Interleaved, Split, parse_split
from core.scans.drive import Drive
from core.scans.mounting import Mounting
from core.segmentation.fixed import PAPER_SEGMENT_LENGTH
from storage.formats.drives.layouts import layout_of

protocol_option: Any = partial(typer.Option, rich_help_panel="Protocol")
"""An option of how a command evaluates."""

_CONDITION = (
    ("yaw deg", "condition.yaw_deg", "g"),
    ("left m", "condition.lateral_m", "g"),
    ("noise m", "condition.noise_m", "g"),
)
_DISTURBED = ("disturb", "condition.disturb", "")


def _list(text: str) -> Any:  # noqa: ANN401 - Typer's own type
    return protocol_option(help=f"{text}, comma-separated.", callback=checked(numbers))


YawOption = Annotated[str, _list("Rotate the query vehicle by degrees, counter-clockwise")]
LateralOption = Annotated[
    str, _list("Shift the query vehicle by metres to the left; R@1 is of the recorded place")
]
NoiseOption = Annotated[str, _list("Standard deviation of noise on every coordinate, in metres")]
ToleranceOption = Annotated[
    str,
    _list("Distance from where the query was recorded, within which a match is correct, in metres"),
]
DisturbOption = Annotated[
    str,
    protocol_option(
        help="Disturb the queries: a comma-separated list of NAME:VALUE, those of one query joined"
        f" by +. NAME: {', '.join(DISTURBANCES)}.",
        callback=checked(parse_disturbances),
        metavar="A+B,C",
    ),
]
SeedOption = Annotated[int, protocol_option(min=0, help="Seed of noise and disturbances.")]
SegmentsOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Number of segments L, in place of k: k = ceil(K / L). Of fixed segments turns add"
        f" none. [k = {PAPER_SEGMENT_LENGTH}]",
        rich_help_panel="Map",
    ),
]
SplitOption = Annotated[
    str | None, protocol_option(help="interleaved:F[:PHASE] or every:N. [interleaved:0.2]")
]
FieldProtocolOption = Annotated[
    str | None,
    protocol_option(
        metavar="|".join(FIELD_PROTOCOLS),
        help="Published protocol; it sets map, queries, exclusion and tolerance.",
    ),
]
JsonOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="File to write the figures to; it is replaced."),
]


def split_of(text: str | None) -> Split:
    """Return the split of the option, the paper's by default."""
    return Interleaved() if text is None else parse_split(text)


def conditions_of(
    yaw_deg: str, lateral_m: str, noise_m: str, disturb: str
) -> tuple[Condition, ...]:
    """Return the conditions of the options, each combined with each."""
    return conditions(numbers(yaw_deg), numbers(lateral_m), numbers(noise_m), disturb.split(","))


def mounting_of_queries(
    given: Mounting | None, of_map: Mounting | None, *, other_drive: bool
) -> Mounting | None:
    """Return the mounting with which other drives than the map's are read, by default the map's.

    Args:
        given: The mounting that `--query-mounting` gives.
        of_map: The mounting of the map's drive.
        other_drive: Whether there is another drive.

    Raises:
        InvalidParameters: If it is given and there is none: queries of the map's drive have its
            mounting.
    """
    if given is not None and not other_drive:
        raise InvalidParameters(
            "--query-mounting is of DRIVE2 and DRIVE3: give --query-drive or --unknown"
        )
    return given or of_map


def chosen_protocol(
    context: typer.Context, name: str | None, path: Path, drive: Drive, fixed: Sequence[str]
) -> FieldProtocol | None:
    """Return the preset of `--protocol`, `None` without it; its check of the poses is printed.

    Args:
        context: The command's context.
        name: The preset's name.
        path: The drive's path.
        drive: What is mapped.
        fixed: Parameters of the command that a preset fixes.

    Raises:
        InvalidParameters: If one of those is given too, or the preset has no rules for the drive.
    """
    if name is None:
        return None
    given = [
        f"--{parameter.replace('_', '-')}"
        for parameter in fixed
        if getattr(context.get_parameter_source(parameter), "name", "") == "COMMANDLINE"
    ]
    if given:
        raise InvalidParameters(
            f"--protocol {name} chooses map, queries, exclusion and tolerance: leave out"
            f" {', '.join(given)}"
        )
    layout = layout_of(path)
    preset = field_protocol(name, drive, layout)
    if layout == KITTI and drive.name in KITTI_SCANS:
        _show_revisits(drive)
    return preset


def _show_revisits(drive: Drive) -> None:
    """Print how often a sequence of KITTI comes back, beside the known number."""
    whole = KITTI_SCANS[drive.name]
    if len(drive) != whole:
        say(
            f"KITTI {drive.name} has {whole} scans, this drive {len(drive)}: its revisits are not"
            " compared with the known ones"
        )
        return
    found, known = revisits(drive), KNOWN_REVISITS[drive.name]
    comparison = "agrees" if found.agrees_with(known) else "are these the poses of the sequence?"
    say(
        f"revisits of every third scan, within 3 m after more than 30 s: {found}; known of KITTI"
        f" {drive.name}: {known}; {comparison}"
    )


def show_table(
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    title: str | None = None,
    named: bool = False,
    repeated: int = 0,
) -> None:
    """Print a table without borders, or several below one another if it does not fit.

    Args:
        headings: The columns' headings.
        rows: Cells.
        title: Above it.
        named: Whether the first column has names, not numbers.
        repeated: The number of columns that each of several tables begins with; without any there
            is one table.
    """
    for part in _fitting(headings, rows, repeated):
        table = Table(box=SIMPLE_HEAD, padding=0, title=title, title_justify="left")
        for column in part:
            name = named and column == 0
            table.add_column(headings[column], justify="left" if name else "right", no_wrap=name)
        for row in rows:
            table.add_row(*(row[column] for column in part))
        show(table)
        title = None


def _fitting(
    headings: Sequence[str], rows: Sequence[Sequence[str]], repeated: int
) -> list[list[int]]:
    """Return the columns of each of the tables that fit, their headings being of two lines."""
    columns = list(range(len(headings)))
    widths = [
        1 + max(map(len, [*headings[column].split(" ", 1), *(row[column] for row in rows)]))
        for column in columns
    ]
    if not repeated or sum(widths) - 1 <= output().width:
        return [columns]
    parts: list[list[int]] = []
    for column in columns[repeated:]:
        if not parts or sum(widths[at] for at in [*parts[-1], column]) - 1 > output().width:
            parts.append(columns[:repeated])
        parts[-1].append(column)
    return parts


def show_conditions(
    rows: Sequence[Any], columns: Sequence[tuple[str, str, str]], *, title: str | None = None
) -> None:
    """Print a row for each condition.

    Args:
        rows: Figures, each with its `condition`.
        columns: Heading, dotted attribute and format. Of a tuple the length is shown, and of a
            mapping each item, the key being put into the heading.
        title: Above it.
    """
    headings: list[str] = []
    cells: list[list[str]] = [[] for _ in rows]
    disturbed = [_DISTURBED] if any(row.condition.disturb for row in rows) else []
    for heading, attribute, form in (*_CONDITION, *disturbed, *columns):
        values = [attrgetter(attribute)(row) for row in rows]
        if isinstance(values[0], dict):
            headings += [heading.format(key) for key in values[0]]
        else:
            headings.append(heading)
        for row, value in zip(cells, values, strict=True):
            shown = value.values() if isinstance(value, dict) else [value]
            row += [str(len(v)) if isinstance(v, tuple) else figure(v, form) for v in shown]
    show_table(headings, cells, title=title, repeated=len(_CONDITION) + len(disturbed))


def findable_text(findable: Mapping[float, int]) -> str:
    """Return how many queries are findable within which distances.

    Examples:
        >>> findable_text({3.0: 11, 10.0: 16})
        'findable 11 within 3 m, 16 within 10 m'
    """
    counts = (f"{count} within {metres:g} m" for metres, count in findable.items())
    return f"findable {', '.join(counts)}"


def require_figures(path: Path | None, *others: Path | None) -> None:
    """Check, before long work, that figures can be written to a file, if one is given.

    Raises:
        typer.BadParameter: As of `require_file_or_stream`, and if it is one of `others`, the other
            files of the command.
    """
    if path is not None:
        require_file_or_stream(path)
        require_apart(path, *others)


def of_drive(drive: Path) -> dict[str, Any]:
    """Return what the figures of a drive depend on besides the configuration."""
    return {"provenance": provenance(), "data": str(drive)}


def write_figures(path: Path | None, figures: dict[str, Any], indent: int | None = 2) -> None:
    """Write figures as JSON, if a file is given."""
    if path is not None:
        with written(path) as part:
            part.write_text(json.dumps(figures, indent=indent, allow_nan=False))
