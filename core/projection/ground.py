"""The ground below a sensor: a plane through the lowest returns.

It is specified to the operation, so that a client in C or JavaScript gives the same bytes:
docs/reference/signature.md. All arithmetic is float64 on the float32 coordinates, each operation
rounded by itself (no fused multiply-add); sums are added one by one, in the order of the cells.

1. **Lowest returns.** The square of 48 m around the sensor has 24 x 24 cells of 2 m: a return is
   in cell (floor(x / 2), floor(y / 2)). The four cells at the sensor are the vehicle's own; cells
   whose middle is 24 m away or more are left out. Each cell gives its lowest return; of equally
   low ones that with the smallest x, then the smallest y. Cells are ordered by x, then by y.
2. **Consensus.** Candidates are the slopes (a, b) = (i / 50, j / 50), i * i + j * j <= 100, ordered
   by i * i + j * j, then i, then j, each with windows of four bins of 0.05 m. The plausible depths
   of the ground below a sensor of height h are from max(0.4 h, h - 1.5) to min(2.2 h, h + 1.5).
   A cell's bin is floor((z - (a * x + b * y) + deepest) * 20), from 0 to ceil((deepest -
   shallowest) * 20) - 1, at least 3. A window from bin k scores 4 for each cell in it, -6 for each
   in the bins k - 10 to k - 2 (nothing is below the ground; slopes between the candidates need a
   bin of play) and -(i * i + j * j). The highest score wins, of equal ones the first candidate and
   its lowest window; the plane is in its middle, z = a * x + b * y + ((k + 2) / 20 - deepest).
3. **Least squares.** Four times: the cells with |z - (a * x + b * y + offset)| of at most 0.3, 0.2,
   0.15 and 0.15 m, 20 or more, give the next plane. With x, y and z minus their means, the sums
   xx + 50, xy, yy + 50, xz, yz and D = xx * yy - xy * xy it is a = (yy * xz - xy * yz) / D,
   b = (xx * yz - xy * xz) / D, offset = mean z - (a * mean x + b * mean y). The 50 square metres
   keep it near to level where it has little support.
4. **Support.** The cells at most 0.15 m from the last plane support it. There is no plane where one
   of these fails: 20 cells; their spread along their narrow side, the root of the smaller
   eigenvalue of the covariance of x and y, is 2 m; the depth is plausible; the slope is at most
   0.22; they are a share of all cells of 0.15 + 2.5 * max(0, (h - depth) / h - 0.05) +
   10 * max(0, roughness - 0.05) + under. The roughness is the root of the mean of their squared
   distances in metres; under is the share of all cells that are deeper than 0.15 m below the
   plane. Banks, hedges and cars are rougher than ground, and above it; nothing is below it.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from core.numbers import require_above
from core.projection.blocks import blocks

_CELL_M = 2.0
_HALF = 12  # cells from the sensor to the edge
_SIDE = 2 * _HALF + 2  # with one cell more on each side, for what is farther away
_SLOPES, _SLOPES_PER_UNIT = 10, 50.0
_BINS_PER_M, _WINDOW, _GAP, _BELOW = 20.0, 4, 1, 10
_IN, _UNDER = 4, 6
_TOLERANCES_M = (0.3, 0.2, 0.15, 0.15)
_RIDGE_M2 = 50.0
_LEAST_CELLS, _LEAST_SPREAD_M, _STEEPEST = 20, 2.0, 0.22
_LEAST_SHARE = 0.15
_SHARE_BY_HIGHER, _SURE_OF_HEIGHT = 2.5, 0.05
_SHARE_BY_ROUGH, _SMOOTH_M = 10.0, 0.05


@dataclass(frozen=True)
class GroundPlane:
    """The ground in the sensor's frame, z = slope_x * x + slope_y * y + offset_m."""

    slope_x: float
    slope_y: float
    offset_m: float

    @property
    def normal(self) -> tuple[float, float, float]:
        """Upwards, of length 1."""
        length = math.sqrt(1.0 + self.slope_x * self.slope_x + self.slope_y * self.slope_y)
        return -self.slope_x / length, -self.slope_y / length, 1.0 / length

    @property
    def depth_m(self) -> float:
        """How far the plane is below the sensor."""
        return -self.offset_m * self.normal[2]


def ground_plane(points_m: Float32Array, sensor_height_m: float) -> GroundPlane | None:
    """Return the ground around a sensor, `None` where too little of it is seen.

    Args:
        points_m: `(n, 3)`, finite, sensor at the origin; their order does not matter.
        sensor_height_m: The sensor's height above ground, about.

    Raises:
        InvalidParameters: If `sensor_height_m` is not above 0.
    """
    [plane] = ground_planes(points_m, [sensor_height_m])
    return plane


def ground_planes(
    points_m: Float32Array, sensor_heights_m: Iterable[float]
) -> Iterator[GroundPlane | None]:
    """Yield the ground as `ground_plane` returns it for each of several heights of the sensor.

    What does not depend on the height is computed once.
    """
    cells: FloatArray | None = None
    for sensor_height_m in sensor_heights_m:
        require_above(0, sensor_height_m=sensor_height_m)
        if cells is None:
            cells = _lowest_returns(points_m)
        yield _plane_of(cells, sensor_height_m)


def _plane_of(cells: FloatArray, sensor_height_m: float) -> GroundPlane | None:
    if cells.shape[1] < _LEAST_CELLS:
        return None
    plane = _consensus(cells, sensor_height_m)
    for tolerance_m in _TOLERANCES_M:
        agree = np.abs(_above_m(plane, cells)) <= tolerance_m
        if np.count_nonzero(agree) < _LEAST_CELLS:
            return None
        plane = _least_squares(*cells[:, agree])
    return plane if _is_supported(plane, cells, sensor_height_m) else None


def _is_supported(plane: GroundPlane, cells: FloatArray, sensor_height_m: float) -> bool:
    """Return whether enough of the ground is seen to trust a plane."""
    above_m = _above_m(plane, cells)
    agree = np.abs(above_m) <= _TOLERANCES_M[-1]
    count = np.count_nonzero(agree)
    shallowest_m, deepest_m = _plausible_m(sensor_height_m)
    if (
        count < _LEAST_CELLS
        or not shallowest_m <= plane.depth_m <= deepest_m
        or plane.slope_x * plane.slope_x + plane.slope_y * plane.slope_y > _STEEPEST * _STEEPEST
        or _narrow_side_m(*cells[:2, agree]) < _LEAST_SPREAD_M
    ):
        return False
    higher = (sensor_height_m - plane.depth_m) / sensor_height_m
    rough_m = math.sqrt(_sum(above_m[agree] * above_m[agree]) / count)
    least_share = (
        _LEAST_SHARE
        + _SHARE_BY_HIGHER * max(0.0, higher - _SURE_OF_HEIGHT)
        + _SHARE_BY_ROUGH * max(0.0, rough_m - _SMOOTH_M)
        + np.count_nonzero(above_m < -_TOLERANCES_M[-1]) / len(above_m)
    )
    return bool(count / len(above_m) >= least_share)


def _lowest_returns(points_m: Float32Array) -> FloatArray:
    """Return the lowest return of each cell, `(3, c)`."""
    cell = np.empty(len(points_m), dtype=np.int64)
    lowest_m = np.full(_SIDE * _SIDE, np.inf, dtype=np.float32)
    for block in blocks(points_m):
        xy_m, z = np.floor(points_m[block, :2].T, order="C"), points_m[block, 2]
        row, column = np.clip(xy_m, -2 * _HALF - 1, 2 * _HALF).astype(np.int64) >> 1
        cell[block] = (row + _HALF + 1) * _SIDE + (column + _HALF + 1)
        np.minimum.at(lowest_m, cell[block], z)
    lowest_m[~_USED] = np.nan  # equal to nothing
    at = np.flatnonzero(points_m[:, 2] == lowest_m[cell])
    cell, found = cell[at], points_m[at].T.astype(np.float64)
    order = np.lexsort((found[1], found[0], cell))
    cell, found = cell[order], found[:, order]
    return found[:, np.flatnonzero(np.diff(cell, prepend=-1))]


def _used() -> BoolArray:
    """Return which cells are neither the vehicle's own nor too far away, flat."""
    middle_m = (np.arange(_SIDE) - _HALF - 0.5) * _CELL_M
    x, y = np.meshgrid(middle_m, middle_m, indexing="ij")
    reach_m = _HALF * _CELL_M
    own = (np.abs(x) < _CELL_M) & (np.abs(y) < _CELL_M)
    return np.asarray((~own & (x * x + y * y < reach_m * reach_m)).ravel())


def _candidates() -> IntArray:
    """Return the slopes, `(3, s)`: i, j and i * i + j * j."""
    i, j = np.mgrid[-_SLOPES : _SLOPES + 1, -_SLOPES : _SLOPES + 1].reshape(2, -1)
    steep = i * i + j * j
    order = np.argsort(steep, kind="stable")
    return np.asarray(np.stack([i, j, steep])[:, order[steep[order] <= _SLOPES * _SLOPES]])


_USED = _used()
_CANDIDATES = _candidates()


def _plausible_m(sensor_height_m: float) -> tuple[float, float]:
    return (
        max(0.4 * sensor_height_m, sensor_height_m - 1.5),
        min(2.2 * sensor_height_m, sensor_height_m + 1.5),
    )


def _consensus(cells: FloatArray, sensor_height_m: float) -> GroundPlane:
    """Return the candidate with the highest score."""
    i, j, steep = _CANDIDATES
    slope_x, slope_y = i / _SLOPES_PER_UNIT, j / _SLOPES_PER_UNIT
    shallowest_m, deepest_m = _plausible_m(sensor_height_m)
    bins = max(math.ceil((deepest_m - shallowest_m) * _BINS_PER_M), _WINDOW)
    up_to = np.zeros((len(i), _BELOW + 1 + bins), dtype=np.int64)
    for some in blocks(i, 32):
        counts = _counts(cells, slope_x[some], slope_y[some], deepest_m, bins)
        np.cumsum(counts, axis=1, out=up_to[some, _BELOW + 1 :])
    windows = bins - _WINDOW + 1
    lower, below = up_to[:, :windows], up_to[:, _BELOW:][:, :windows]
    under = up_to[:, _BELOW - _GAP :][:, :windows]
    through = up_to[:, _BELOW + _WINDOW :][:, :windows]
    score = _IN * (through - below) - _UNDER * (under - lower) - steep[:, None]
    best, window = divmod(int(np.argmax(score)), windows)
    middle_m = (window + _WINDOW / 2.0) / _BINS_PER_M - deepest_m
    return GroundPlane(float(slope_x[best]), float(slope_y[best]), middle_m)


def _counts(
    cells: FloatArray, slope_x: FloatArray, slope_y: FloatArray, deepest_m: float, bins: int
) -> IntArray:
    """Return how many cells are in each bin of each slope, `(s, bins)`."""
    x, y, z = cells
    at = slope_x[:, None] * x
    at += slope_y[:, None] * y
    np.subtract(z, at, out=at)
    at += deepest_m
    at *= _BINS_PER_M
    np.clip(np.floor(at, out=at), -1, bins, out=at)
    width = bins + 2  # one bin more on each side, for what is in none
    place = at.astype(np.int64) + (np.arange(len(at)) * width + 1)[:, None]
    return np.bincount(place.ravel(), minlength=len(at) * width).reshape(-1, width)[:, 1:-1]


def _above_m(plane: GroundPlane, cells: FloatArray) -> FloatArray:
    """Return how far each cell's return is above a plane, vertically."""
    x, y, z = cells
    return np.asarray(z - (plane.slope_x * x + plane.slope_y * y + plane.offset_m))


def _least_squares(x: FloatArray, y: FloatArray, z: FloatArray) -> GroundPlane:
    """Return the plane through some cells, a little nearer to level."""
    count = len(x)
    middle_x, middle_y, middle_z = _sum(x) / count, _sum(y) / count, _sum(z) / count
    x, y, z = x - middle_x, y - middle_y, z - middle_z
    xx, xy, yy = _sum(x * x) + _RIDGE_M2, _sum(x * y), _sum(y * y) + _RIDGE_M2
    xz, yz = _sum(x * z), _sum(y * z)
    determinant = xx * yy - xy * xy
    slope_x = (yy * xz - xy * yz) / determinant
    slope_y = (xx * yz - xy * xz) / determinant
    return GroundPlane(slope_x, slope_y, middle_z - (slope_x * middle_x + slope_y * middle_y))


def _narrow_side_m(x: FloatArray, y: FloatArray) -> float:
    """Return the standard deviation of places along the direction in which it is least."""
    count = len(x)
    x, y = x - _sum(x) / count, y - _sum(y) / count
    xx, xy, yy = _sum(x * x), _sum(x * y), _sum(y * y)
    half, apart = (xx + yy) / 2.0, (xx - yy) / 2.0
    return math.sqrt(max(half - math.sqrt(apart * apart + xy * xy), 0.0) / count)


def _sum(values: FloatArray) -> float:
    """Return the sum, added one by one: `np.sum` adds in an order of its own."""
    return float(np.add.accumulate(values)[-1])
