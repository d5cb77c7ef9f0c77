"""`python -m benchmarks [--check] [NAME ...]`: measurements against bars and the committed ratios.

Without names all are run. The rows are written to `RESULTS.md`, with `--check` they are not. A
benchmark that got worse, or misses a bar that it kept, is measured again, at most twice, and each
row counts as it was at its best: what else a machine does only ever adds to a time.
"""

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from benchmarks.machine import Machine, this_machine
from benchmarks.results import (
    Committed,
    Row,
    best,
    committed,
    measured,
    renew,
    show,
    this_commit,
)

_AGAIN = 2

_ALL = (
    "fit_segment",
    "localize",
    "projection",
    "vehicle",
    "match_harmonic",
    "match_views",
    "match_scan",
    "large_maps",
    "answer_overhead",
    "http_answers",
    "large_bodies",
    "build_memory",
    "open_revision",
    "map_bytes",
    "among_maps",
)


def main(names: Sequence[str], *, check: bool) -> int:
    """Run each benchmark in a process of its own; return how many rows missed or got worse."""
    before, machine = committed(), this_machine()
    commit = this_commit()  # before the results are written, which is a change too
    rows: dict[str, list[Row]] = {}
    missed, worse = 0, []
    for name in names or _ALL:
        rows[name] = _at_best(name, _alone(name), before, machine)
        missed += show(rows[name], name)
        worse += before.worse(name, rows[name], machine)
        if not check:
            renew(rows, machine, commit)
    print(f"{missed} bars missed")
    if not machine.is_as(before.machine):
        print(
            f"no times are compared: this is {machine}, the committed ones are of {before.machine}"
        )
    for line in worse:
        print(f"worse: {line}")
    return missed + len(worse)


def _at_best(name: str, rows: list[Row], before: Committed, machine: Machine) -> list[Row]:
    """Measure again while a row that may differ fails; return each row at its best."""
    for _ in range(_AGAIN):
        if not before.fails(name, [row for row in rows if not row.is_exact], machine):
            break
        show(rows, name)
        print(f"{name} is measured again", flush=True)
        rows = best(rows, _alone(name))
    return rows


def _alone(name: str) -> list[Row]:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(measured, name).result()


if __name__ == "__main__":
    words = sys.argv[1:]
    sys.exit(main([word for word in words if word != "--check"], check="--check" in words))
