"""From a scan to a height image: heights above ground around the sensor, ring by ring."""

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray
from core.errors import InvalidScan
from core.projection.angles import azimuth_steps, columns_of_steps
from core.projection.reducer import MOST_M, Reducer, reduce_returns
from core.projection.rings import RingGrid
from core.scans.scan import Scan


def project_heights(
    scan: Scan,
    grid: RingGrid,
    reducer: Reducer,
    sensor_height_m: float,
    column: IntArray | None = None,
) -> Float32Array:
    """Return the height image of a scan, `(I, J)` metres, 0 on the ground and where nothing is.

    Each return's height above ground goes to its `(ring, azimuth)` cell. The height is
    z + `sensor_height_m`, clipped at 0. The result does not
    depend on the order of the returns, but for the rounding of sums.

    Args:
        scan: The returns, sensor at the origin.
        grid: The lattice; returns beyond its last ring are left out.
        reducer: `mean` or `highest` of a shared cell.
        sensor_height_m: The sensor's height above ground.
        column: `(n,)` column of each return, as of `azimuth_columns`, where it is known already.

    Raises:
        InvalidScan: If no return within the last ring is above the ground, or one is above 1e30 m.

    Examples:
        >>> wall = Scan(np.array([[0.0, 10.0, 0.5], [0.0, 11.0, 1.5]]))
        >>> heights_m = project_heights(wall, RingGrid(), Reducer.MEAN, sensor_height_m=2.0)
        >>> heights_m.shape, float(heights_m[2, 90])
        ((20, 360), 3.0)
    """
    reduced = reduce_returns(
        scan.points_m,
        lambda xyz, block: _cells_and_heights(
            xyz, grid, sensor_height_m, None if column is None else column[block]
        ),
        grid.shape,
        reducer,
    )
    if not reduced.inside:
        raise InvalidScan(
            f"none of the {len(scan)} returns is within {grid.reach_m:g} m: are they in the frame"
            " of a map, or millimetres? Wanted are metres in the sensor's frame"
        )
    if reduced.largest > MOST_M:
        raise InvalidScan(f"a return is {reduced.largest:.3g} m high, wanted less than {MOST_M:g}")
    if not reduced.cells.any():
        raise InvalidScan(
            f"none of the {len(scan)} returns is above the ground, which is {sensor_height_m:g} m"
            " below the sensor: check the height, the unit of the returns, and that z is up"
        )
    return reduced.cells


def _cells_and_heights(
    xyz: FloatArray, grid: RingGrid, sensor_height_m: float, column: IntArray | None
) -> tuple[IntArray, FloatArray]:
    """Return the flat cell and the height of each of `(3, m)` returns within the last ring."""
    x, y, z = xyz
    ring = np.floor(np.sqrt(x * x + y * y) / grid.ring_m)
    inside = np.flatnonzero(ring < grid.rings)
    if len(inside) < len(ring):
        ring, x, y, z = (values.take(inside) for values in (ring, x, y, z))
        column = None if column is None else column.take(inside)
    if column is None:
        column = columns_of_steps(azimuth_steps(x, y, grid.azimuth_step_deg), grid.columns)
    heights_m = np.maximum(z + sensor_height_m, 0.0)
    return ring.astype(np.int64) * grid.columns + column, heights_m
