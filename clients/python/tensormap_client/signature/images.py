"""Images of scans: range images and height images, as the service projects them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensormap_client.errors import UnsupportedMap, UnusableScan
from tensormap_client.signature.angles import steps

SECTORS = 60
_MOST_RINGS = 15
_AXES = (3, 4)  # rows of points that lie on their side: x, y, z and an intensity
_MOST_M = 1e30
# As the service checks scans.
_LARGEST_MEDIAN_M = 500.0
_SAMPLED = 1000  # returns
_PART = 8192
_RANGE_REDUCERS = ("last", "nearest", "farthest", "mean")
_HEIGHT_REDUCERS = ("highest", "mean")


def returns(points: ArrayLike) -> NDArray[np.float32]:
    """Return a scan's returns as `(3, n)` float32 metres: x, y and z, each by itself.

    Args:
        points: `(n, 3)` or more columns, of which x, y and z are the first; or records with the
            fields x, y and z. Masked points are left out.

    Raises:
        UnusableScan: If it has no such columns, or rows in their place, or rows of several lengths,
            or they are no metres.
    """
    is_masked = isinstance(points, np.ma.MaskedArray)
    try:
        found: NDArray[Any] = np.asanyarray(points) if is_masked else np.asarray(points)
    except ValueError as error:  # NumPy's own words are of its arrays, not of scans
        raise UnusableScan(
            f"points are a {type(points).__name__} whose rows differ in length, wanted (n, 3)"
            " numbers, or records with x, y and z"
        ) from error
    if {"x", "y", "z"} <= set(found.dtype.names or ()):
        stack = np.ma.stack if is_masked else np.stack
        found = stack([found[axis].ravel() for axis in "xyz"], axis=1)
    if found.ndim != 2 or found.shape[1] < 3 or found.dtype.kind not in "fiu":
        raise UnusableScan(
            f"points have shape {found.shape} and type {found.dtype}, wanted (n, 3) numbers, or"
            " records with x, y and z"
        )
    if found.shape[0] in _AXES and found.shape[1] > max(_AXES):
        raise UnusableScan(
            f"points have shape {found.shape}, wanted (n, 3) or more columns: are they transposed?"
        )
    with np.errstate(over="ignore", invalid="ignore"):  # infinite then, and left out
        xyz_m = found[:, :3].T.astype(np.float32, order="C")
        xyz_m = without_others(np.ma.filled(xyz_m, np.nan))
    _require_metres(xyz_m)
    return xyz_m


def _require_metres(xyz_m: NDArray[np.float32]) -> None:
    """Reject `(3, n)` returns of which half are farther away than a lidar measures."""
    count = xyz_m.shape[1]
    if not count:
        return
    sample = xyz_m[:, :: -(-count // _SAMPLED)]
    median_m = float(np.median(np.abs(sample).max(axis=0)))
    if median_m > _LARGEST_MEDIAN_M:
        raise UnusableScan(
            f"half of the returns are {median_m:.6g} m away or more, a lidar measures within"
            f" {_LARGEST_MEDIAN_M:g} m: are these millimetres, or a map's coordinates? Wanted"
            " metres in the sensor's frame"
        )


def without_others(xyz_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return `(3, n)` returns without what is not finite or zero."""
    keep = np.isfinite(xyz_m).all(axis=0) & (xyz_m != 0.0).any(axis=0)
    return xyz_m if keep.all() else xyz_m[:, keep]


def parts(count: int) -> list[slice]:
    """Return slices of the returns that fit into the processor's cache."""
    return [slice(first, first + _PART) for first in range(0, count, _PART)]


@dataclass(frozen=True)
class View:
    """What a scan saw: the hidden sectors of azimuth, and how many rings, `None` if all."""

    hidden: tuple[int, ...] = ()
    rings: int | None = None

    @property
    def is_narrow(self) -> bool:
        """Whether a third of the azimuths or rings are left out."""
        return len(self.hidden) >= SECTORS // 3 or self.rings is not None


@dataclass(frozen=True, eq=False)
class Projected:
    """A scan's image.

    Attributes:
        cells: The image; 0 is an empty cell.
        visible: Which sectors the scan sees, `(60,)` (signature.md, "Sectors").
    """

    cells: NDArray[np.float32]
    visible: NDArray[np.bool_]


class Grid:
    """The grid of a map's images and how cells are filled.

    Args:
        grid: The grid of the map's parameters.
        reducer: The reducer of the map's parameters.

    Raises:
        UnsupportedMap: If this version does not know such images.
    """

    def __init__(self, grid: Mapping[str, Any], reducer: str) -> None:
        self.is_height = "rings" in grid
        known = _HEIGHT_REDUCERS if self.is_height else _RANGE_REDUCERS
        if reducer not in known:
            raise UnsupportedMap(f"the map's reducer is {reducer!r}, known are {', '.join(known)}")
        self._reducer = reducer
        self._azimuth_deg = float(grid["azimuth_step_deg"])
        turn = round(360.0 / self._azimuth_deg)
        if self.is_height:
            self._ring_m, rows, columns = float(grid["ring_m"]), int(grid["rings"]), turn
        else:
            self._elevation_deg = float(grid["elevation_step_deg"])
            self._first = float(grid["elevation_min_deg"]) / self._elevation_deg
            self._wraps = bool(grid["wraps"])
            rows, columns = int(grid["rows"]), turn + (not self._wraps)
        self.shape = rows, columns

    def project(self, xyz_m: NDArray[np.float32], height_m: float) -> Projected:
        """Return a scan's image.

        Args:
            xyz_m: The returns, `(3, n)`.
            height_m: Height of their origin above ground.

        Raises:
            UnusableScan: If no return is in the image.
        """
        count, (rows, columns) = xyz_m.shape[1], self.shape
        cells, largest_m = Cells(rows * columns, self._reducer), -1.0
        near, far = np.zeros((2, columns), np.bool_)
        for part in parts(count):
            x, y, z = xyz_m[:, part].astype(np.float64)
            squared = x * x + y * y
            across_m = np.sqrt(squared)
            if self.is_height:
                row = np.minimum(across_m / self._ring_m, rows).astype(np.int64)
                metres = np.maximum(z + height_m, 0.0)
            else:
                row = self._elevation(across_m, z)
                metres = np.sqrt(across_m * across_m + z * z)
            column = self._column(xyz_m[:2, part], x, y)
            near[column] = True
            far[column[squared > 36.0]] = True
            inside = np.flatnonzero((row >= 0) & (row < rows))
            if len(inside) < len(row):
                row, column, metres = row[inside], column[inside], metres[inside]
            cells.add(row * columns + column, metres)
            largest_m = max(largest_m, float(metres.max(initial=-1.0)))
        if largest_m < 0.0:
            raise UnusableScan(f"none of the scan's {count} returns is within the image")
        if largest_m > _MOST_M:
            raise UnusableScan(f"a return is {largest_m:.3g} m away, wanted less than {_MOST_M:g}")
        image = cells.reduced().reshape(self.shape)
        if not image.any():
            raise UnusableScan(f"none of the scan's {count} returns is above the ground")
        return Projected(image, self._visible(near, far))

    def _visible(self, near: NDArray[np.bool_], far: NDArray[np.bool_]) -> NDArray[np.bool_]:
        sector = self.sector_of_column
        width = np.maximum(np.bincount(sector, minlength=SECTORS), 1)
        visible = 2.0 * np.bincount(sector, far, SECTORS) >= width
        if np.count_nonzero(visible) < 10:
            visible = np.bincount(sector, near, SECTORS) > 0
        return np.asarray(visible)

    @property
    def sector_of_column(self) -> NDArray[np.int64]:
        """The sector of each column, `(J,)`."""
        return np.arange(self.shape[1]) * SECTORS // self.shape[1]

    def _elevation(
        self, across_m: NDArray[np.float64], z: NDArray[np.float64]
    ) -> NDArray[np.int64]:
        whole = math.floor(self._first + 0.5)

        def exactly_deg(left: NDArray[np.intp]) -> NDArray[np.float64]:
            with np.errstate(divide="ignore"):  # straight up is arctan(inf)
                return np.asarray(np.degrees(np.arctan(z[left] / across_m[left])))

        with np.errstate(over="ignore"):  # computed exactly then
            about_m = across_m.astype(np.float32), z.astype(np.float32)
        return steps(*about_m, self._elevation_deg, self._first - whole, exactly_deg) - whole

    def _column(
        self, xy_m: NDArray[np.float32], x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> NDArray[np.int64]:
        def exactly_deg(left: NDArray[np.intp]) -> NDArray[np.float64]:
            return np.asarray(np.degrees(np.arctan2(y[left], x[left])))

        column = steps(xy_m[0], xy_m[1], self._azimuth_deg, 0.0, exactly_deg)
        turn = round(360.0 / self._azimuth_deg)
        if self.is_height:
            column[column < 0] += turn
            return column
        column += turn // 2
        if self._wraps:
            column[column == turn] = 0
        return column


class Cells:
    """One number for each cell, reduced from its returns.

    Args:
        count: Number of cells.
        reducer: Which number a cell keeps.
    """

    def __init__(self, count: int, reducer: str) -> None:
        self._reducer, self._count = reducer, count
        self._kept = np.full(count, np.inf if reducer == "nearest" else 0.0, np.float32)
        if reducer == "mean":
            self._sums, self._counts = np.zeros(count), np.zeros(count, np.int64)

    def add(self, cell: NDArray[np.int64], metres: NDArray[np.float64]) -> None:
        """Add returns, in their order."""
        if self._reducer == "mean":
            np.add.at(self._sums, cell, metres)
            self._counts += np.bincount(cell, minlength=self._count)
            return
        with np.errstate(over="ignore"):  # refused then
            rounded_m = metres.astype(np.float32)
        if self._reducer == "last":
            self._kept[cell] = rounded_m
        else:
            keep = np.minimum if self._reducer == "nearest" else np.maximum
            keep.at(self._kept, cell, rounded_m)

    def reduced(self) -> NDArray[np.float32]:
        """Return the cells' numbers, 0 where there is no return."""
        if self._reducer == "mean":
            return np.asarray(self._sums / np.maximum(self._counts, 1), np.float32)
        self._kept[np.isinf(self._kept)] = 0.0
        return self._kept


def rings_in_reach(cells: NDArray[np.float32]) -> int | None:
    """Return how many rings are within a scan's reach, `None` if all (signature.md, "Rings")."""
    last = int(np.flatnonzero(cells.any(axis=1))[-1])
    if last >= 0.6 * len(cells) or last > _MOST_RINGS:
        return None
    return min(max(last, 3), len(cells))
