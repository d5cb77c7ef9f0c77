"""`python -m benchmarks [--check] [NAME ...]`: measurements against bars and the committed ratios.

Without names all are run. The rows are written to `RESULTS.md`, with `--check` they are not.
"""

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from benchmarks.results import Row, committed, measured, renew, show, this_machine

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
)


def main(names: Sequence[str], *, check: bool) -> int:
    """Run each benchmark in a process of its own; return how many rows missed or got worse."""
    before, machine = committed(), this_machine()
    rows: dict[str, list[Row]] = {}
    missed, worse = 0, []
    for name in names or _ALL:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
            rows[name] = alone.submit(measured, name).result()
        missed += show(rows[name], name)
        worse += before.worse(name, rows[name], machine)
        if not check:
            renew(rows, machine)
    print(f"{missed} bars missed")
    for line in worse:
        print(f"worse: {line}")
    return missed + len(worse)


if __name__ == "__main__":
    words = sys.argv[1:]
    sys.exit(main([word for word in words if word != "--check"], check="--check" in words))
