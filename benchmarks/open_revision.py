"""Open the file of a revision of 1,000 segments: bounds and checksums, without the digest.

Under 10 ms of this process's time when the digest was checked before in this process, as for
a query that finds the revision no longer in memory, and at most three times as long as h5py takes
for the arrays alone, on any machine. The time with the digest is beside.
"""

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import h5py

from benchmarks.maps import random_paper_map
from benchmarks.results import Row, show
from storage.files.map_file import read_map, read_revision, write_map

BAR_MS, BAR_TIMES_H5PY = 10.0, 3.0
SEGMENTS, SCANS_A_SEGMENT = 1000, 20
RUNS = 31


def measure() -> list[Row]:
    """Return the rows."""
    tensor_map = random_paper_map(SEGMENTS, SCANS_A_SEGMENT, poses=False)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "map.h5")
        write_map(path, tensor_map)
        digest = tensor_map.revision

        def by_h5py() -> None:
            with h5py.File(path, "r", locking=False) as file:
                for name in file:
                    file[name][()]

        opened_s = _median_s(lambda: read_revision(path, digest))
        checked_s, h5py_s = _median_s(lambda: read_map(path)), _median_s(by_h5py)
        size_mb = path.stat().st_size / 1e6
    what = f"open {SEGMENTS} segments, {len(tensor_map)} scans, {size_mb:.1f} MB"
    beside = f"{1e3 * checked_s:.1f} with the digest; h5py, arrays alone {1e3 * h5py_s:.1f}"
    return [
        Row(f"{what}, ms", 1e3 * opened_s, BAR_MS, beside, of_machine=True),
        Row(f"{what}, times h5py for the arrays", opened_s / h5py_s, BAR_TIMES_H5PY),
    ]


def _median_s(function: Callable[[], object]) -> float:
    """Return the median of the seconds that this process works on it."""
    times = []
    for _ in range(RUNS):
        begun = time.process_time()
        function()
        times.append(time.process_time() - begun)
    return statistics.median(times)


if __name__ == "__main__":
    sys.exit(show(measure()))
