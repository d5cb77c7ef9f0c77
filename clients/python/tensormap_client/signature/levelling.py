"""Scans rotated level above the ground, where enough of it is seen (signature.md, "Levelling")."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensormap_client.signature.images import parts, without_others

_HALF = 12  # cells of 2 m from the sensor to the edge
_BINS_PER_M, _WINDOW, _BELOW = 20.0, 4, 10
_TOLERANCES_M = (0.3, 0.2, 0.15, 0.15)
_LEAST_CELLS = 20


@dataclass(frozen=True)
class Plane:
    """The ground in the sensor's frame, z = a x + b y + offset_m."""

    a: float
    b: float
    offset_m: float

    def above_m(self, cells: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far each of `(3, c)` returns is above it, vertically."""
        x, y, z = cells
        return np.asarray(z - (self.a * x + self.b * y + self.offset_m))

    @property
    def normal(self) -> tuple[float, float, float]:
        """Upwards, of length 1."""
        length = math.sqrt(1.0 + self.a * self.a + self.b * self.b)
        return -self.a / length, -self.b / length, 1.0 / length

    @property
    def depth_m(self) -> float:
        """How far below the sensor it is."""
        return -self.offset_m * self.normal[2]


def level(
    xyz_m: NDArray[np.float32], height_m: float, *, is_level: bool = False
) -> NDArray[np.float32]:
    """Return `(3, n)` returns as a level sensor of a height sees them, unchanged without ground.

    Args:
        xyz_m: The returns, `(3, n)`, finite, sensor at the origin.
        height_m: The sensor's approximate height above ground.
        is_level: Whether z is up by gravity; the ground then only gives the height.
    """
    plane = ground(xyz_m, height_m)
    if plane is None:
        return xyz_m
    nx, ny, nz = plane.normal
    c, up_m = 1.0 + nz, plane.depth_m - height_m
    xx, xy, yy = 1.0 - nx * nx / c, -(nx * ny) / c, 1.0 - ny * ny / c
    moved_m = xyz_m.copy() if is_level else np.empty_like(xyz_m)
    with np.errstate(over="ignore"):  # infinite then, and left out as no return
        for part in parts(xyz_m.shape[1]):
            x, y, z = xyz_m[:, part].astype(np.float64)
            if is_level:
                moved_m[2, part] = z + (-plane.offset_m - height_m)
                continue
            moved_m[0, part] = xx * x + xy * y - nx * z
            moved_m[1, part] = xy * x + yy * y - ny * z
            moved_m[2, part] = nx * x + ny * y + nz * z + up_m
    return without_others(moved_m)


def ground(xyz_m: NDArray[np.float32], height_m: float) -> Plane | None:
    """Return the plane of the ground, `None` where too little of it is seen."""
    cells = _lowest_returns(xyz_m)
    if cells.shape[1] < _LEAST_CELLS:
        return None
    plane = _consensus(cells, height_m)
    for tolerance_m in _TOLERANCES_M:
        agree = np.abs(plane.above_m(cells)) <= tolerance_m
        if np.count_nonzero(agree) < _LEAST_CELLS:
            return None
        plane = _least_squares(cells[:, agree])
    return plane if _is_supported(plane, cells, height_m) else None


def _lowest_returns(xyz_m: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the lowest return of each cell, `(3, c)`, cells ordered by x, then y."""
    edge_m = np.float32(2.0 * _HALF)
    x, y, z = xyz_m
    cell = np.empty(len(z), np.intp)
    for part in parts(len(z)):
        near = (x[part] >= -edge_m) & (x[part] < edge_m) & (y[part] >= -edge_m) & (y[part] < edge_m)
        # The others are put into the vehicle's own cells.
        i, j = np.floor(xyz_m[:2, part] * near).astype(np.int32) >> 1
        cell[part] = (i + _HALF) * (2 * _HALF) + (j + _HALF)
    lowest_m = np.full(len(_IS_USED), np.inf, np.float32)
    np.minimum.at(lowest_m, cell, z)
    lowest = np.flatnonzero(z == lowest_m[cell])
    lowest = lowest[_IS_USED[cell[lowest]]]
    order = lowest[np.lexsort((y[lowest], x[lowest], cell[lowest]))]
    first = order[np.diff(cell[order], prepend=-1) > 0]
    return np.asarray([x[first], y[first], z[first]], np.float64)


def _used() -> NDArray[np.bool_]:
    """Return which cells are neither the vehicle's own nor too far away."""
    middle_m = 2.0 * np.arange(-_HALF, _HALF) + 1.0
    x, y = np.meshgrid(middle_m, middle_m, indexing="ij")
    own = np.maximum(np.abs(x), np.abs(y)) < 2.0
    return np.asarray(~own & (x * x + y * y < (2.0 * _HALF) ** 2)).ravel()


_IS_USED = _used()


def _plausible_m(height_m: float) -> tuple[float, float]:
    return max(0.4 * height_m, height_m - 1.5), min(2.2 * height_m, height_m + 1.5)


def _candidates() -> NDArray[np.int64]:
    """Return i, j and i i + j j of the slopes, `(3, s)`, in their order."""
    pairs = sorted(
        (i * i + j * j, i, j)
        for i in range(-10, 11)
        for j in range(-10, 11)
        if i * i + j * j <= 100
    )
    steep, i, j = np.array(pairs).T
    return np.stack([i, j, steep])


_CANDIDATES = _candidates()


def _consensus(cells: NDArray[np.float64], height_m: float) -> Plane:
    """Return the candidate with the highest score."""
    x, y, z = cells
    i, j, steep = _CANDIDATES
    a, b = i / 50.0, j / 50.0
    shallowest_m, deepest_m = _plausible_m(height_m)
    bins = max(math.ceil((deepest_m - shallowest_m) * _BINS_PER_M), _WINDOW)
    place = np.multiply.outer(a, x)
    place += np.multiply.outer(b, y)
    np.subtract(z, place, out=place)
    place += deepest_m
    place *= _BINS_PER_M
    np.clip(np.floor(place, out=place), -1.0, bins, out=place)
    # A bin below all others, and one above.
    place += (np.arange(len(i)) * (bins + 2) + 1)[:, None]
    counts = np.bincount(place.ravel().astype(np.intp), minlength=len(i) * (bins + 2))
    counts = counts.reshape(len(i), bins + 2)[:, 1:-1]
    # `up_to[:, k + 10]` is how many are in bins below k.
    up_to = np.pad(np.cumsum(counts, axis=1), ((0, 0), (_BELOW + 1, 0)))
    first = np.arange(bins - _WINDOW + 1) + _BELOW
    within = up_to[:, first + _WINDOW] - up_to[:, first]
    under = up_to[:, first - 1] - up_to[:, first - _BELOW]
    best, k = divmod(int(np.argmax(4 * within - 6 * under - steep[:, None])), len(first))
    return Plane(float(a[best]), float(b[best]), (k + 2) / _BINS_PER_M - deepest_m)


def _sum(values: NDArray[np.float64]) -> float:
    """Return the sum, added one by one."""
    return float(np.add.accumulate(values)[-1])


def _centred(cells: NDArray[np.float64]) -> tuple[list[float], list[NDArray[np.float64]]]:
    means = [_sum(values) / len(values) for values in cells]
    return means, [values - mean for values, mean in zip(cells, means, strict=True)]


def _least_squares(cells: NDArray[np.float64]) -> Plane:
    (mean_x, mean_y, mean_z), (x, y, z) = _centred(cells)
    xx, xy, yy = _sum(x * x) + 50.0, _sum(x * y), _sum(y * y) + 50.0
    xz, yz = _sum(x * z), _sum(y * z)
    d = xx * yy - xy * xy
    a, b = (yy * xz - xy * yz) / d, (xx * yz - xy * xz) / d
    return Plane(a, b, mean_z - (a * mean_x + b * mean_y))


def _is_supported(plane: Plane, cells: NDArray[np.float64], height_m: float) -> bool:
    above_m = plane.above_m(cells)
    agree = np.abs(above_m) <= _TOLERANCES_M[-1]
    count = int(np.count_nonzero(agree))
    shallowest_m, deepest_m = _plausible_m(height_m)
    if (
        count < _LEAST_CELLS
        or _narrow_side_m(cells[:2, agree]) < 2.0
        or not shallowest_m <= plane.depth_m <= deepest_m
        or plane.a * plane.a + plane.b * plane.b > 0.22 * 0.22
    ):
        return False
    rough_m = math.sqrt(_sum(above_m[agree] * above_m[agree]) / count)
    under = int(np.count_nonzero(above_m < -_TOLERANCES_M[-1])) / len(above_m)
    higher = (height_m - plane.depth_m) / height_m
    least_share = 0.15 + 2.5 * max(0.0, higher - 0.05) + 10.0 * max(0.0, rough_m - 0.05) + under
    return count / len(above_m) >= least_share


def _narrow_side_m(places: NDArray[np.float64]) -> float:
    """Return the standard deviation of `(2, c)` places along the direction in which it is least."""
    _, (x, y) = _centred(places)
    xx, xy, yy = _sum(x * x), _sum(x * y), _sum(y * y)
    half, apart = (xx + yy) / 2.0, (xx - yy) / 2.0
    return math.sqrt(max(half - math.sqrt(apart * apart + xy * xy), 0.0) / len(x))


def rotated(
    xyz_m: NDArray[np.floating[Any]], roll_deg: float, pitch_deg: float, yaw_deg: float = 0.0
) -> NDArray[np.float64]:
    """Return `(3, n)` returns rotated by R = Rz(yaw) Ry(pitch) Rx(roll)."""
    (cx, sx), (cy, sy), (cz, sz) = (
        (math.cos(angle), math.sin(angle))
        for angle in map(math.radians, (roll_deg, pitch_deg, yaw_deg))
    )
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    rows = np.ascontiguousarray(xyz_m.T, np.float64)
    return np.asarray(rows @ (about_z @ about_y @ about_x).T).T
