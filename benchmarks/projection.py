"""Project a scan of 60,000 returns, against plain NumPy: whole arrays, `arctan2`, `hypot`.

At most its time; why it is not three times as fast:
docs/decisions/0036-projection-without-a-compiler.md.
"""

import sys
from collections.abc import Callable

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.queried_map import RETURNS, large_scan
from benchmarks.results import Row, show
from benchmarks.timing import medians_s
from core.arrays import Float32Array
from core.projection.height_image import project_heights
from core.projection.range_image import project_scan
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.scans.scan import Scan
from core.scans.sensor import AngularGrid

BAR = 1.0
RUNS = 41
HEIGHT_M = 1.73


def measure() -> list[Row]:
    """Return a row of each kind of image."""
    threadpool_limits(limits=1)
    scan = Scan(np.frombuffer(large_scan(), "<f4").reshape(-1, 4)[:, :3])
    rings, angles = RingGrid(), AngularGrid()
    kinds: dict[str, tuple[Callable[[], Float32Array], Callable[[], Float32Array]]] = {
        "heights": (
            lambda: project_heights(scan, rings, Reducer.HIGHEST, HEIGHT_M),
            lambda: plain_heights(scan.points_m, rings),
        ),
        "ranges": (
            lambda: project_scan(scan, angles, Reducer.NEAREST),
            lambda: _plain_ranges(scan.points_m, angles),
        ),
    }
    rows = []
    for kind, (ours, plain) in kinds.items():
        assert np.allclose(ours(), plain())  # noqa: S101 - else the comparison is void
        our_s, plain_s = medians_s(ours, plain, RUNS)
        what = f"{kind} of {RETURNS} returns, ms"
        rows.append(Row(what, 1e3 * our_s, 1e3 * BAR * plain_s, f"plain NumPy {1e3 * plain_s:.2f}"))
    return rows


def plain_heights(points_m: Float32Array, grid: RingGrid) -> Float32Array:
    """Return the height image as a few lines of NumPy make it."""
    x, y, z = points_m.T.astype(np.float64)
    ring = np.floor(np.hypot(x, y) / grid.ring_m).astype(np.int64)
    column = np.rint(np.degrees(np.arctan2(y, x)) / grid.azimuth_step_deg).astype(np.int64)
    near = ring < grid.rings
    image = np.zeros(grid.shape, np.float32)
    heights_m = np.maximum(z + HEIGHT_M, 0.0).astype(np.float32)
    np.maximum.at(image, (ring[near], column[near] % grid.columns), heights_m[near])
    return image


def _plain_ranges(points_m: Float32Array, grid: AngularGrid) -> Float32Array:
    x, y, z = points_m.T.astype(np.float64)
    across = np.hypot(x, y)
    row = np.rint(np.degrees(np.arctan2(z, across))).astype(np.int64) + 25
    column = np.rint(np.degrees(np.arctan2(y, x))).astype(np.int64) + 180
    inside = (row >= 0) & (row < grid.rows)
    image = np.full(grid.shape, np.inf, np.float32)
    ranges_m = np.hypot(across, z).astype(np.float32)
    np.minimum.at(image, (row[inside], column[inside]), ranges_m[inside])
    image[np.isinf(image)] = 0.0
    return image


if __name__ == "__main__":
    sys.exit(show(measure()))
