"""Output of commands: tables on standard output, progress on standard error."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich import progress
from rich.console import Console

_FILE_COLUMNS = 160  # a file or pipe has no width; Rich's 80 would cut figures off


def output() -> Console:
    """Return a console on standard output."""
    has_width = sys.stdout.isatty() or "COLUMNS" in os.environ  # which Rich detects
    return Console(width=None if has_width else _FILE_COLUMNS)


def say(line: str) -> None:
    """Print a line unchanged, of any length."""
    output().print(line, markup=False, highlight=False, soft_wrap=True)


def figure(value: float | str | None, form: str) -> str:
    """Return a number for a table, `-` if it is unknown."""
    return "-" if value is None else format(value, form)


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

    def finish(self) -> None:
        """Fill the bar: its stage is over, also if units were skipped."""
        if self._task is not None:
            self._bars.update(self._task, completed=self._bars.tasks[self._task].total)


@contextmanager
def progress_bar() -> Iterator[BarProgress]:
    """Show progress while the block runs."""
    columns = (
        progress.TextColumn("{task.description:>12}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeRemainingColumn(),
    )
    with progress.Progress(*columns, console=Console(stderr=True)) as bars:
        bar = BarProgress(bars)
        yield bar
        bar.finish()
