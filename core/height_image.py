"""From a scan to a height image: how high things stand around the sensor, ring by ring."""

from dataclasses import dataclass

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray, frozen
from core.blocks import place_returns
from core.errors import InvalidImage, InvalidParameters, InvalidScan
from core.projection import Reducer
from core.rings import RingGrid
from core.scan import Scan

__all__ = ["HEIGHT_REDUCERS", "HeightImage", "project_heights"]

HEIGHT_REDUCERS = (Reducer.MEAN, Reducer.HIGHEST)


@dataclass(frozen=True, eq=False)
class HeightImage:
    """Heights above ground on a polar grid.

    Attributes:
        heights_m: `(I, J)` float32 metres, finite, 0 where nothing fell and on the ground.
        grid: The lattice of rings and azimuths.
        outside_returns: Returns beyond the last ring, left out.
    """

    heights_m: Float32Array
    grid: RingGrid
    outside_returns: int = 0

    def __post_init__(self) -> None:
        heights = np.asarray(self.heights_m)
        if heights.shape != self.grid.shape:
            raise InvalidImage(
                f"heights_m has shape {heights.shape}, the grid has {self.grid.shape}"
            )
        heights = frozen(heights, np.float32)
        if not np.isfinite(heights).all() or (heights < 0).any():
            raise InvalidImage("heights_m holds values that are not finite or are negative")
        if not heights.any():
            raise InvalidImage("heights_m is empty: every cell is 0")
        object.__setattr__(self, "heights_m", heights)

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
        grid: The lattice; returns beyond its last ring are left out and counted.
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
    cells, z = place_returns(scan.points_m, lambda xyz: _cells_and_z(xyz, grid))
    if not len(cells):
        raise InvalidScan(f"none of the {len(scan)} returns is within {grid.reach_m:g} m")
    heights_m = np.maximum(z + sensor_height_m, 0.0)
    if heights_m.max() > np.finfo(np.float32).max:
        raise InvalidScan(f"a return is {heights_m.max():.3g} m high, beyond float32")
    if not heights_m.any():
        raise InvalidScan(f"none of the {len(scan)} returns stands above the ground")
    cell_count = grid.rows * grid.columns
    if reducer == Reducer.MEAN:
        sums = np.bincount(cells, weights=heights_m, minlength=cell_count)
        counts = np.bincount(cells, minlength=cell_count)
        image = np.divide(sums, np.maximum(counts, 1)).astype(np.float32)
    else:
        image = np.zeros(cell_count, dtype=np.float32)
        np.maximum.at(image, cells, heights_m.astype(np.float32))
    if not image.any():  # below the least float32
        raise InvalidScan(f"none of the {len(scan)} returns stands above the ground")
    return HeightImage(image.reshape(grid.shape), grid, outside_returns=len(scan) - len(cells))


def _cells_and_z(xyz: FloatArray, grid: RingGrid) -> tuple[IntArray, FloatArray]:
    """Return the flat cell and z of each of `(3, m)` returns within the last ring."""
    x, y, z = xyz
    ring = np.floor(np.sqrt(x * x + y * y) / grid.ring_m)
    inside = ring < grid.rings
    if not inside.all():
        ring, x, y, z = (values[inside] for values in (ring, x, y, z))
    steps = np.rint(np.degrees(np.arctan2(y, x)) / grid.azimuth_step_deg).astype(np.int64)
    return ring.astype(np.int64) * grid.columns + steps % grid.columns, z
