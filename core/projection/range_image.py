"""From a scan to a range image (paper, sec. 2.1)."""

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray
from core.errors import InvalidScan
from core.projection.angles import azimuth_steps, elevation_steps
from core.projection.reducer import LEAST_M, MOST_M, Reducer, reduce_returns
from core.scans.scan import Scan
from core.scans.sensor import AngularGrid, whole_and_fraction


def project_scan(scan: Scan, grid: AngularGrid, reducer: Reducer) -> Float32Array:
    """Return the range image of a scan, the paper's matrix S, `(I, J)`.

    Each return's range goes to its rounded `(elevation, azimuth)` cell.

    The paper leaves open which return wins a shared cell: `reducer` decides, and all reducers but
    `last` are independent of the order of the points (`mean` up to the rounding of its sum).

    Args:
        scan: The returns, sensor at the origin.
        grid: The lattice; returns outside it are left out.
        reducer: Which return a shared cell keeps.

    Returns:
        `(I, J)` metres, 0 where no return is.

    Raises:
        InvalidScan: If no return falls inside the grid, a range is above 1e30 m, or all of them
            are next to 0.

    Examples:
        >>> ahead = Scan(np.array([[10.0, 0.0, 0.0], [12.0, 0.0, 0.0]]))
        >>> ranges_m = project_scan(ahead, AngularGrid(), Reducer.FARTHEST)
        >>> ranges_m.shape, float(ranges_m[25, 180])
        ((30, 361), 12.0)
    """
    reduced = reduce_returns(
        scan.points_m, lambda xyz, _: _cells_and_ranges(xyz, grid), grid.shape, reducer
    )
    if not reduced.inside:
        raise InvalidScan(
            f"none of the {len(scan)} returns falls inside the grid, elevations"
            f" {grid.elevations_deg[0]:.4g}..{grid.elevations_deg[-1]:.4g} deg"
        )
    if reduced.largest > MOST_M:
        raise InvalidScan(f"a return is {reduced.largest:.3g} m away, wanted less than {MOST_M:g}")
    if not reduced.cells.any():
        raise InvalidScan(
            f"none of the {len(scan)} returns gives a range of {LEAST_M:.2g} m or more: are they"
            " metres?"
        )
    return reduced.cells


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
