"""Rows of benchmarks, each with its bar, and the committed table that they are compared with.

The ratio of a row is the share of its bar that it takes: at most 1 holds. Bars are measured beside
the row where that is possible, so that ratios of another machine are comparable.
"""

import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from app.provenance import provenance
from benchmarks.machine import ALIKE, Machine

RESULTS = Path(__file__).with_name("RESULTS.md")
WORSE = 1.3
"""By so much a ratio may exceed the committed one on a machine of the same name."""
WORSE_ELSEWHERE = 1.6
"""The same on another: measured on two, ratios to what is beside a row differ by up to 1.4."""
_HEAD = "| benchmark | what | measured | bar | ratio | holds | beside it | commit |"
_MACHINE, _OF_MACHINE = "Machine: ", "(\\*)"


_PAGE = """# Results of the benchmarks

Written by `make bench`, or by `python -m benchmarks NAME` for one. The ratio is the share of its
bar that a row takes. Where the bar is a time or a size, marked (\\*), it is compared with the
committed one only on the same machine at the same speed: of one name, whose yardstick (CPU time of
a fixed task) differs by a factor of at most {alike:g}. Other bars were measured in the same run. A
run fails if a row misses a bar that it held in the committed table, if a new row misses its bar, or
if a row takes more than {worse:g} times its committed ratio, {elsewhere:g} times on a machine of
another name.
"""


@dataclass(frozen=True)
class Row:
    """One measurement.

    Attributes:
        name: What was measured, and its unit.
        measured: The measured value.
        bar: The most that it may be.
        beside: What it cannot be less than, or what others take, measured in the same run.
        at_least: Whether the bar is the least instead.
        of_machine: Whether the bar is a time, so that another machine has another ratio.
        is_exact: Whether it is the same in each run, so that nothing is gained by another.
    """

    name: str
    measured: float
    bar: float
    beside: str = ""
    at_least: bool = False
    of_machine: bool = False
    is_exact: bool = False

    @property
    def ratio(self) -> float:
        """The share of the bar that is taken, at most 1 if it holds."""
        return self.bar / self.measured if self.at_least else self.measured / self.bar

    @property
    def holds(self) -> bool:
        """Whether the bar is kept."""
        return self.ratio <= 1.0

    def line(self, benchmark: str, commit: str = "") -> str:
        """Return the row of the table."""
        bar = f"{'>=' if self.at_least else '<='} {self.bar:.3g}"
        if self.of_machine:
            bar += f" {_OF_MACHINE}"
        holds = "yes" if self.holds else "**no**"
        cells = (benchmark, self.name, f"{self.measured:.3g}", bar, f"{self.ratio:.2f}", holds)
        return f"| {' | '.join(cells)} | {self.beside} | {commit} |"


@dataclass(frozen=True)
class Committed:
    """The ratios of an earlier run.

    Attributes:
        machine: The machine that it was measured on.
        lines: The lines of its table, by benchmark.
        ratios: The ratios by benchmark and name of the row.
        of_machine: Which of them another machine does not have.
    """

    machine: Machine
    lines: Mapping[str, Sequence[str]]
    ratios: Mapping[tuple[str, str], float]
    of_machine: frozenset[tuple[str, str]]

    @classmethod
    def of_text(cls, text: str) -> "Committed":
        """Return what a table says, nothing of an empty one.

        Examples:
            >>> text = table({"walk": [Row("steps", 4.0, 8.0).line("walk")]}, Machine("slow"))
            >>> Committed.of_text(text).ratios
            {('walk', 'steps'): 0.5}
        """
        lines = text.splitlines()
        found = [line.removeprefix(_MACHINE) for line in lines if line.startswith(_MACHINE)]
        kept = _rows_of(lines)
        rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in kept]
        by_benchmark: dict[str, list[str]] = {}
        for row, line in zip(rows, kept, strict=True):
            by_benchmark.setdefault(row[0], []).append(line)
        return cls(
            Machine.of_text(found[0] if found else ""),
            by_benchmark,
            {(row[0], row[1]): _ratio(row[2], row[3]) for row in rows},
            frozenset((row[0], row[1]) for row in rows if row[3].endswith(_OF_MACHINE)),
        )

    def worse(self, benchmark: str, rows: Iterable[Row], machine: Machine) -> list[str]:
        """Return which rows take more of their bar than they did, by more than `WORSE`.

        On a machine of another name by more than `WORSE_ELSEWHERE`.
        """
        most = WORSE if machine.name == self.machine.name else WORSE_ELSEWHERE
        return [
            f"{benchmark}: {row.name}: {row.ratio:.2f} of its bar, committed {before:.2f}"
            for row in rows
            if (before := self._comparable((benchmark, row.name), machine)) is not None
            and row.ratio > most * before
        ]

    def fails(self, benchmark: str, rows: Sequence[Row], machine: Machine) -> bool:
        """Return whether a row got worse, or misses a bar that it kept or is new to."""
        missed = [row for row in rows if not row.holds]
        kept = any(self.ratios.get((benchmark, row.name), 0.0) <= 1.0 for row in missed)
        return kept or bool(self.worse(benchmark, rows, machine))

    def _comparable(self, key: tuple[str, str], machine: Machine) -> float | None:
        if key in self.of_machine and not machine.is_as(self.machine):
            return None
        return self.ratios.get(key)


def _rows_of(lines: Sequence[str]) -> Sequence[str]:
    if _HEAD not in lines:
        return ()
    return [line for line in lines[lines.index(_HEAD) + 2 :] if line.startswith("| ")]


def _ratio(measured: str, bar: str) -> float:
    """Return the ratio of a row of the table: two digits of a small one are as coarse as a quarter.

    Examples:
        >>> round(_ratio("3.89", "<= 100 (*)"), 4), _ratio("200", ">= 300")
        (0.0389, 1.5)
    """
    direction, most = bar.split()[:2]
    ratio = float(measured) / float(most)
    return 1.0 / ratio if direction == ">=" else ratio


def table(lines: Mapping[str, Sequence[str]], machine: Machine) -> str:
    """Return the page of all rows, by benchmark."""
    rows = [line for some in lines.values() for line in some]
    page = _PAGE.format(worse=WORSE, elsewhere=WORSE_ELSEWHERE, alike=ALIKE)
    return "\n".join([page, f"{_MACHINE}{machine}", "", _HEAD, "|---" * 8 + "|", *rows, ""])


def this_commit() -> str:
    """Return the commit that is checked out, marked if a file was changed; empty without one."""
    return provenance()["commit"] or ""


def renew(rows: Mapping[str, Sequence[Row]], machine: Machine, commit: str) -> None:
    """Write these benchmarks' rows; those of others stay, times only of the same machine.

    The yardstick stays that of the first rows: small differences do not add up.
    """
    before = Committed.of_text(RESULTS.read_text() if RESULTS.exists() else "")
    lines = {name: [row.line(name, commit) for row in some] for name, some in rows.items()}
    if machine.is_as(before.machine):
        RESULTS.write_text(table({**before.lines, **lines}, before.machine))
        return
    kept = {
        name: [line for line in some if _OF_MACHINE not in line]
        for name, some in before.lines.items()
    }
    RESULTS.write_text(
        table({**{name: some for name, some in kept.items() if some}, **lines}, machine)
    )


def committed() -> Committed:
    """Return the results of the commit that is checked out, none outside a checkout."""
    command = ["git", "-C", str(RESULTS.parent), "show", f"HEAD:./{RESULTS.name}"]
    try:
        shown = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return Committed.of_text("")
    return Committed.of_text(shown.stdout)


def measured(benchmark: str) -> list[Row]:
    """Return what a benchmark measures; in the process that imports it here."""
    rows: list[Row] = import_module(f"benchmarks.{benchmark}").measure()
    return rows


def best(rows: Iterable[Row], others: Iterable[Row]) -> list[Row]:
    """Return of each row of two runs the one that takes less of its bar.

    Examples:
        >>> calm, noisy = Row("walk, s", 4.0, 8.0), Row("walk, s", 9.0, 8.0)
        >>> best([noisy], [calm]) == best([calm], [noisy]) == [calm]
        True
    """
    pairs = zip(rows, others, strict=True)
    return [min(pair, key=lambda row: row.ratio) for pair in pairs]


def show(rows: Sequence[Row], benchmark: str = "") -> int:
    """Print rows and return how many miss their bar."""
    for row in rows:
        print(row.line(benchmark), flush=True)
    return sum(not row.holds for row in rows)
