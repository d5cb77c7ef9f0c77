"""From 60,000 returns to a packed signature in C++, against levelling and projection in NumPy.

At most a third of the time of `core.projection.levelling` and the plain projection of
`benchmarks.projection`, though it includes the signature: docs/decisions/0043-conformance.md.
"""

import sys
from tempfile import TemporaryDirectory

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.projection import HEIGHT_M, plain_heights
from benchmarks.queried_map import RETURNS, large_scan
from benchmarks.results import Row, show
from benchmarks.timing import medians_s
from core.projection.levelling import level
from core.projection.rings import RingGrid
from core.scans.scan import Scan
from tests.support.cpp import COMPILER, CppSignatures
from tests.vectors.outcomes import FOLDER

BAR = 1.0 / 3.0
RUNS = 41


def measure() -> list[Row]:
    """Return the row of the C++ example, none without a compiler."""
    if COMPILER is None:
        return []
    threadpool_limits(limits=1)
    rows = np.frombuffer(large_scan(), "<f4").reshape(-1, 4)
    scan, grid = Scan(rows[:, :3]), RingGrid()
    with TemporaryDirectory() as folder:
        cpp = CppSignatures((FOLDER / "bases" / "any-views.json").read_text(), folder)
        cpp_s, plain_s = medians_s(
            lambda: cpp.query(rows, HEIGHT_M),
            lambda: plain_heights(level(scan, HEIGHT_M).points_m, grid),
            RUNS,
        )
    what = f"C++: signature of {RETURNS} returns, ms"
    return [Row(what, 1e3 * cpp_s, 1e3 * BAR * plain_s, f"NumPy without it {1e3 * plain_s:.2f}")]


if __name__ == "__main__":
    sys.exit(show(measure()))
