"""From a scan to a height image: how high things stand around the sensor, ring by ring."""

from dataclasses import dataclass

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray
from core.errors import InvalidParameters, InvalidScan
from core.projection.angles import azimuth_steps
from core.projection.cells import checked_cells
from core.projection.reducer import HEIGHT_REDUCERS, Reducer, reduce_returns
from core.projection.rings import RingGrid
from core.scans.scan import Scan


@dataclass(frozen=True, eq=False)
class HeightImage:
    """Heights above ground on a polar grid.

    Attributes:
        heights_m: `(I, J)` float32 metres, finite, 0 where nothing fell and on the ground.
        grid: The lattice of rings and azimuths.
    """

    heights_m: Float32Array
    grid: RingGrid

    def __post_init__(self) -> None:
        cells = checked_cells("heights_m", self.heights_m, self.grid.shape)
        object.__setattr__(self, "heights_m", cells)

    @property
    def cells(self) -> Float32Array:
        """`(I, J)`, the matrix that is encoded."""
        return self.heights_m


def project_heights(
    scan: Scan, grid: RingGrid, reducer: Reducer, sensor_height_m: float
) -> HeightImage:
    """Place each return's height above ground at its `(ring, azimuth)` cell.

    The height is z + `sensor_height_m`, clipped at 0: what lies below the ground is on it. The
    result is independent of the order of the returns (`mean` up to the rounding of its sum).

    Args:
        scan: The returns, sensor at the origin.
        grid: The lattice; returns beyond its last ring are left out.
        reducer: `mean` or `highest` of a shared cell.
        sensor_height_m: The sensor's height above ground.

    Raises:
        InvalidScan: If no return within the last ring stands above the ground.
        InvalidParameters: If the reducer is another.

    Examples:
        >>> wall = Scan(np.array([[0.0, 10.0, 0.5], [0.0, 11.0, 1.5]]))
        >>> image = project_heights(wall, RingGrid(), Reducer.MEAN, sensor_height_m=2.0)
        >>> image.heights_m.shape, float(image.heights_m[2, 90])
        ((20, 360), 3.0)
    """
    if reducer not in HEIGHT_REDUCERS:
        raise InvalidParameters(
            f"a height image is reduced by {' or '.join(HEIGHT_REDUCERS)}, not by {reducer}"
        )
    cell_count = grid.rows * grid.columns
    reduced = reduce_returns(
        scan.points_m,
        lambda xyz: _cells_and_heights(xyz, grid, sensor_height_m),
        cell_count,
        reducer,
    )
    if not reduced.inside:
        raise InvalidScan(f"none of the {len(scan)} returns is within {grid.reach_m:g} m")
    if reduced.largest > float(np.finfo(np.float32).max):
        raise InvalidScan(f"a return is {reduced.largest:.3g} m high, beyond float32")
    if not reduced.cells.any():
        raise InvalidScan(f"none of the {len(scan)} returns stands above the ground")
    return HeightImage(reduced.cells.reshape(grid.shape), grid)


def _cells_and_heights(
    xyz: FloatArray, grid: RingGrid, sensor_height_m: float
) -> tuple[IntArray, FloatArray]:
    """Return the flat cell and the height of each of `(3, m)` returns within the last ring."""
    x, y, z = xyz
    ring = np.floor(np.sqrt(x * x + y * y) / grid.ring_m)
    inside = np.flatnonzero(ring < grid.rings)
    if len(inside) < len(ring):
        ring, x, y, z = (values.take(inside) for values in (ring, x, y, z))
    column = azimuth_steps(x, y, grid.azimuth_step_deg) % grid.columns
    heights_m = np.maximum(z + sensor_height_m, 0.0)
    return ring.astype(np.int64) * grid.columns + column, heights_m
