"""Output of commands: tables on standard output, progress and notes on standard error."""

import os
import sys
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import typer
from rich import progress
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

_LINE_EVERY_S = 5.0
_UNBOUNDED = 100_000  # columns: more than any name
_LEAST_NAME = 12  # characters that are left of one
_FILE_COLUMNS = 160  # a file or pipe has no width; Rich's 80 would cut figures off


def output() -> Console:
    """Return a console on standard output."""
    return _console(width=None if _has_width() else _FILE_COLUMNS)


def _console(**options: Any) -> Console:  # noqa: ANN401 - Rich's own
    """Return a console that shows text as it is: names of files and drives may have `[` and `:`."""
    return Console(markup=False, emoji=False, highlight=False, **options)


def _has_width() -> bool:
    return sys.stdout.isatty() or "COLUMNS" in os.environ  # which Rich detects


def say(line: str) -> None:
    """Print a line unchanged, of any length."""
    output().print(line, soft_wrap=True)


def say_note(note: str) -> None:
    """Print what to know about a result beside it: on standard error, as an error is."""
    typer.echo(f"tensormap: {note}", err=True)


def show(table: Table, *, names: Collection[str] = ()) -> None:
    """Print a table, of which no figure is cut off.

    Where it does not fit it has no borders, and headings of two lines. If that is not enough, names
    lose their middle in a terminal; and if that is not either, lines are longer than its own.

    Args:
        table: The table; its cells are text.
        names: Headings of columns of names, whose middle may be left out.
    """
    wanted = output().width
    of_names = [column for column in table.columns if column.header in names]
    for column in table.columns:
        column.no_wrap = True
    if _width(table) > wanted:
        table.box, table.padding, table.show_edge = SIMPLE_HEAD, (0, 0), False
        for column in table.columns:
            column.header = str(column.header).replace(" ", "\n", 1)
    if _has_width():
        _shorten(of_names, _width(table) - wanted)
    _console(width=max(wanted, _width(table))).print(table)


def _shorten(columns: Sequence[Column], excess: int) -> None:
    """Take that many characters from the widest of these columns, but leave some of each name."""
    widths = [max(map(len, map(str, column.cells)), default=0) for column in columns]
    most = max(widths, default=0)
    while most > _LEAST_NAME and sum(width - min(width, most) for width in widths) < excess:
        most -= 1
    for column in columns:
        column._cells = [_without_middle(str(cell), most) for cell in column.cells]


def _without_middle(name: str, most: int) -> str:
    """Return a name of at most so many characters; its end, which has the number, is longer."""
    if len(name) <= most:
        return name
    begin = (most - 1) // 3
    return f"{name[:begin]}…{name[begin + 1 - most :]}"


def _width(table: Table) -> int:
    return _console(width=_UNBOUNDED).measure(table).maximum


def figure(value: float | str | None, form: str) -> str:
    """Return a number for a table, `-` if it is unknown."""
    return "-" if value is None else format(value, form)


_SENT = "sent_bytes"


class _Rate(progress.ProgressColumn):
    """The rate of a transfer, empty for other work."""

    def render(self, task: progress.Task) -> Text:
        """Return bytes in a second, since the stage began."""
        sent, elapsed_s = task.fields.get(_SENT), task.elapsed
        return Text(_rate(sent, elapsed_s) if sent and elapsed_s else "")


def _rate(sent_bytes: int, elapsed_s: float) -> str:
    return f"{sent_bytes / elapsed_s / 1e6:.1f} MB/s"


def _position(stage: str, done: int, total: int) -> str:
    return f"{stage}: {done} of {total}"


class BarProgress:
    """A `core.progress.Progress` that draws one bar a stage."""

    def __init__(self, bars: progress.Progress) -> None:
        self._bars = bars
        self._task: progress.TaskID | None = None

    def start(self, stage: str, total: int) -> None:
        """Begin a new bar; the one before is full."""
        self.finish()
        self._task = self._bars.add_task(stage, total=total)

    def advance(self, units: int = 1) -> None:
        """Move the bar."""
        if self._task is not None:
            self._bars.advance(self._task, units)

    def move_to(self, done: int) -> None:
        """Set the bar."""
        if self._task is not None:
            self._bars.update(self._task, completed=done)

    def sent(self, size_bytes: int) -> None:
        """Count bytes for the rate of a transfer."""
        if self._task is not None:
            before = self._bars.tasks[self._task].fields.get(_SENT, 0)
            self._bars.update(self._task, **{_SENT: before + size_bytes})

    @property
    def position(self) -> str | None:
        """How far the stage is, as `uploading: 57 of 501`; `None` before the first one."""
        if self._task is None:
            return None
        task = self._bars.tasks[self._task]
        return _position(task.description, int(task.completed), int(task.total or 0))

    def finish(self) -> None:
        """Fill the bar: its stage is over, also if units were skipped."""
        if self._task is not None:
            self._bars.update(self._task, completed=self._bars.tasks[self._task].total)


class LineProgress:
    """A `core.progress.Progress` that writes a line now and then, where there is no terminal."""

    def __init__(self) -> None:
        self._stage = ""
        self._done = self._total = self._sent_bytes = self._first = 0
        self._shown = -1
        self._began_s = self._shown_s = time.monotonic()

    def start(self, stage: str, total: int) -> None:
        """Begin a new stage; the one before is done."""
        self.finish()
        self._stage, self._total = stage, total
        self._done = self._sent_bytes = self._first = 0
        self._shown = -1
        self._began_s = self._shown_s = time.monotonic()

    def advance(self, units: int = 1) -> None:
        """Count units."""
        self._done += units
        if self._stage and time.monotonic() - self._shown_s >= _LINE_EVERY_S:
            self._show()

    def move_to(self, done: int) -> None:
        """Set the number of units; the first ones of a stage were done before."""
        if not self._done:
            self._first = done
        self.advance(done - self._done)

    def sent(self, size_bytes: int) -> None:
        """Count bytes for the rate of a transfer."""
        self._sent_bytes += size_bytes

    @property
    def position(self) -> str | None:
        """How far the stage is, as `uploading: 57 of 501`; `None` where there is none."""
        return _position(self._stage, self._done, self._total) if self._stage else None

    def finish(self) -> None:
        """Write the last line of a stage: it is over, also if units were skipped."""
        if self._stage:
            self._done = self._total
            if self._shown != self._total:
                self._show()
            self._stage = ""

    def _show(self) -> None:
        self._shown_s, self._shown = time.monotonic(), self._done
        elapsed_s = self._shown_s - self._began_s
        line = _position(self._stage, self._done, self._total)
        if self._sent_bytes and elapsed_s:
            line += f", {_rate(self._sent_bytes, elapsed_s)}"
        if self._done > self._first and self._done < self._total:
            left_s = elapsed_s / (self._done - self._first) * (self._total - self._done)
            line += f", {left_s:.0f} s left"
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()


@contextmanager
def progress_bar(
    *, of_transfer: bool = False, beside_output: bool = False
) -> Iterator[BarProgress | LineProgress]:
    """Show progress while the block runs, in lines where there is no terminal.

    Args:
        of_transfer: Whether bytes are sent, whose rate is shown.
        beside_output: Whether the block writes to standard output; where that is a terminal,
            progress is in lines too.
    """
    console = _console(stderr=True)
    if not console.is_terminal or (beside_output and sys.stdout.isatty()):
        lines = LineProgress()
        yield lines
        lines.finish()
        return
    columns = (
        progress.TextColumn("{task.description:>12}", markup=False),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        *([_Rate()] if of_transfer else []),
        progress.TimeRemainingColumn(),
    )
    # By default Rich writes what goes to standard output to its console, standard error.
    with progress.Progress(*columns, console=console, redirect_stdout=not beside_output) as bars:
        bar = BarProgress(bars)
        yield bar
        bar.finish()
