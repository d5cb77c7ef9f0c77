"""`python -m benchmarks [NAME ...]`: every measurement against its bar and the committed ratio.

Without names all are run, and `RESULTS.md` is written.
"""

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from benchmarks.results import RESULTS, Row, committed, measured, show, table, this_machine

_ALL = (
    "fit_segment",
    "localize",
    "projection",
    "match_harmonic",
    "match_views",
    "match_scan",
    "answer_overhead",
    "http_answers",
    "large_bodies",
    "build_memory",
    "open_revision",
)


def main(names: Sequence[str]) -> int:
    """Run each benchmark in a process of its own; return how many rows missed or got worse."""
    before, machine = committed(), this_machine()
    rows: dict[str, list[Row]] = {}
    missed, worse = 0, []
    for name in names or _ALL:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
            rows[name] = alone.submit(measured, name).result()
        missed += show(rows[name], name)
        worse += before.worse(name, rows[name], machine)
    if not names:
        RESULTS.write_text(table(rows, machine, "make bench"))
    print(f"{missed} bars missed")
    for line in worse:
        print(f"worse: {line}")
    return missed + len(worse)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
