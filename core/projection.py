"""From a scan to a range image (paper, sec. 2.1)."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray, frozen
from core.blocks import place_returns
from core.errors import InvalidImage, InvalidParameters, InvalidScan
from core.scan import Scan
from core.sensor import AngularGrid, whole_and_fraction

__all__ = ["RANGE_REDUCERS", "RangeImage", "Reducer", "project_scan"]


class Reducer(StrEnum):
    """Which return a shared cell keeps; the paper leaves it open.

    `highest` is for height images only.
    """

    LAST = "last"
    NEAREST = "nearest"
    FARTHEST = "farthest"
    MEAN = "mean"
    HIGHEST = "highest"


RANGE_REDUCERS = (Reducer.LAST, Reducer.NEAREST, Reducer.FARTHEST, Reducer.MEAN)


@dataclass(frozen=True, eq=False)
class RangeImage:
    """Ranges on a grid; the paper's matricized scan S.

    Attributes:
        ranges_m: `(I, J)` float32 metres, finite, 0 where nothing fell.
        grid: The lattice of elevations and azimuths.
        outside_returns: Returns outside the grid, left out.
    """

    ranges_m: Float32Array
    grid: AngularGrid
    outside_returns: int = 0

    def __post_init__(self) -> None:
        ranges = np.asarray(self.ranges_m)
        if ranges.shape != self.grid.shape:
            raise InvalidImage(f"ranges_m has shape {ranges.shape}, the grid has {self.grid.shape}")
        ranges = frozen(ranges, np.float32)
        if not np.isfinite(ranges).all() or (ranges < 0).any():
            raise InvalidImage("ranges_m holds values that are not finite or are negative")
        if not ranges.any():
            raise InvalidImage("ranges_m is empty: every cell is 0")
        object.__setattr__(self, "ranges_m", ranges)

    @property
    def cells(self) -> Float32Array:
        """`(I, J)`, the matrix that is encoded."""
        return self.ranges_m


def project_scan(scan: Scan, grid: AngularGrid, reducer: Reducer) -> RangeImage:
    """Place each return's range at its rounded `(elevation, azimuth)` cell.

    The paper leaves open which return wins a shared cell: `reducer` decides, and all reducers but
    `last` are independent of the order of the points (`mean` up to the rounding of its sum).

    Args:
        scan: The returns, sensor at the origin.
        grid: The lattice; returns outside it are left out and counted.
        reducer: Which return a shared cell keeps.

    Returns:
        Ranges of shape `(I, J)` in metres, 0 where no return fell.

    Raises:
        InvalidScan: If no return falls inside the grid, or a range is beyond float32.
        InvalidParameters: If the reducer is none of range images.

    Examples:
        >>> ahead = Scan(np.array([[10.0, 0.0, 0.0], [12.0, 0.0, 0.0]]))
        >>> image = project_scan(ahead, AngularGrid(), Reducer.FARTHEST)
        >>> image.ranges_m.shape, float(image.ranges_m[25, 180])
        ((30, 361), 12.0)
    """
    if reducer not in RANGE_REDUCERS:
        raise InvalidParameters(
            f"a range image is reduced by {', '.join(RANGE_REDUCERS)}, not by {reducer}"
        )
    cells, range_m = place_returns(scan.points_m, lambda xyz: _cells_and_ranges(xyz, grid))
    if not len(cells):
        raise InvalidScan(
            f"none of the {len(scan)} returns falls inside the grid, elevations"
            f" {grid.elevations_deg[0]:.4g}..{grid.elevations_deg[-1]:.4g} deg"
        )
    if range_m.max() > np.finfo(np.float32).max:
        raise InvalidScan(f"a return is {range_m.max():.3g} m away, beyond float32")
    ranges_m = _reduce(cells, range_m, grid.rows * grid.columns, reducer)
    return RangeImage(ranges_m.reshape(grid.shape), grid, outside_returns=len(scan) - len(cells))


def _cells_and_ranges(xyz: FloatArray, grid: AngularGrid) -> tuple[IntArray, FloatArray]:
    """Return the flat cell and the range of each of `(3, m)` returns inside the grid."""
    x, y, z = xyz
    # sqrt and arctan are vectorized where hypot and arctan2 are not, and take a third to half of
    # the time. Squares of float32 do not overflow float64, and straight up is arctan(inf).
    across_m = np.sqrt(x * x + y * y)
    with np.errstate(divide="ignore"):
        elevation_steps = np.degrees(np.arctan(z / across_m)) / grid.elevation_step_deg
    whole, fraction = whole_and_fraction(grid.elevation_min_deg / grid.elevation_step_deg)
    row = np.rint(elevation_steps - fraction).astype(np.int64) - whole
    inside = (row >= 0) & (row < grid.rows)
    if not inside.all():
        row, x, y, z, across_m = (values[inside] for values in (row, x, y, z, across_m))
    steps_a_turn = round(360.0 / grid.azimuth_step_deg)
    azimuth_steps = np.rint(np.degrees(np.arctan2(y, x)) / grid.azimuth_step_deg)
    column = azimuth_steps.astype(np.int64) + steps_a_turn // 2
    if grid.wraps:
        column %= steps_a_turn
    return row * grid.columns + column, np.sqrt(across_m * across_m + z * z)


def _reduce(
    cells: IntArray, range_m: FloatArray, cell_count: int, reducer: Reducer
) -> Float32Array:
    if reducer == Reducer.MEAN:
        sums = np.bincount(cells, weights=range_m, minlength=cell_count)
        counts = np.bincount(cells, minlength=cell_count)
        return np.divide(sums, np.maximum(counts, 1)).astype(np.float32)
    image = np.zeros(cell_count, dtype=np.float32)
    values = range_m.astype(np.float32)
    if reducer == Reducer.LAST:
        # NumPy's tutorial says that the last of repeated indices is kept, its reference promises no
        # order: a test holds it to the former.
        image[cells] = values
    elif reducer == Reducer.FARTHEST:
        np.maximum.at(image, cells, values)
    else:
        image[cells] = np.inf
        np.minimum.at(image, cells, values)
    return image
