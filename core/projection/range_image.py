"""From a scan to a range image (paper, sec. 2.1)."""

from dataclasses import dataclass

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray
from core.errors import InvalidParameters, InvalidScan
from core.projection.angles import azimuth_steps, elevation_steps
from core.projection.cells import checked_cells
from core.projection.reducer import RANGE_REDUCERS, Reducer, reduce_returns
from core.scans.scan import Scan
from core.scans.sensor import AngularGrid, whole_and_fraction


@dataclass(frozen=True, eq=False)
class RangeImage:
    """Ranges on a grid; the paper's matricized scan S.

    Attributes:
        ranges_m: `(I, J)` float32 metres, finite, 0 where nothing fell.
        grid: The lattice of elevations and azimuths.
    """

    ranges_m: Float32Array
    grid: AngularGrid

    def __post_init__(self) -> None:
        cells = checked_cells("ranges_m", self.ranges_m, self.grid.shape)
        object.__setattr__(self, "ranges_m", cells)

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
        grid: The lattice; returns outside it are left out.
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
    cell_count = grid.rows * grid.columns
    reduced = reduce_returns(
        scan.points_m, lambda xyz: _cells_and_ranges(xyz, grid), cell_count, reducer
    )
    if not reduced.inside:
        raise InvalidScan(
            f"none of the {len(scan)} returns falls inside the grid, elevations"
            f" {grid.elevations_deg[0]:.4g}..{grid.elevations_deg[-1]:.4g} deg"
        )
    if reduced.largest > float(np.finfo(np.float32).max):
        raise InvalidScan(f"a return is {reduced.largest:.3g} m away, beyond float32")
    return RangeImage(reduced.cells.reshape(grid.shape), grid)


def _cells_and_ranges(xyz: FloatArray, grid: AngularGrid) -> tuple[IntArray, FloatArray]:
    """Return the flat cell and the range of each of `(3, m)` returns inside the grid."""
    x, y, z = xyz
    # sqrt is vectorized where hypot is not. Squares of float32 do not overflow float64.
    across_m = np.sqrt(x * x + y * y)
    whole, fraction = whole_and_fraction(grid.elevation_min_deg / grid.elevation_step_deg)
    row = elevation_steps(across_m, z, grid.elevation_step_deg, fraction) - whole
    inside = np.flatnonzero((row >= 0) & (row < grid.rows))
    if len(inside) < len(row):
        row, x, y, z, across_m = (values.take(inside) for values in (row, x, y, z, across_m))
    steps_a_turn = round(360.0 / grid.azimuth_step_deg)
    column = azimuth_steps(x, y, grid.azimuth_step_deg) + steps_a_turn // 2
    if grid.wraps:
        column %= steps_a_turn
    return row * grid.columns + column, np.sqrt(across_m * across_m + z * z)
