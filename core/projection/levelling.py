"""Scans rotated level above the ground, as far as it is seen.

With a plane of the normal n = (nx, ny, nz), depth below the sensor and c = 1 + nz, a return becomes

    x' = (1 - nx * nx / c) * x + (-(nx * ny) / c) * y - nx * z
    y' = (-(nx * ny) / c) * x + (1 - ny * ny / c) * y - ny * z
    z' = nx * x + ny * y + nz * z + (depth - height)

in float64, from left to right, each operation rounded by itself, and is then rounded to float32.

Of a scan that is level by gravity the plane only gives how far below the sensor the ground is:
z' = z + (-offset - height).
"""

import numpy as np

from core.arrays import Float32Array, FloatArray
from core.projection.blocks import blocks
from core.projection.ground import GroundPlane, ground_plane
from core.scans.scan import Scan


def level(scan: Scan, sensor_height_m: float) -> Scan:
    """Return a scan as a level sensor of that height would see it.

    The smallest rotation that brings the ground's normal to +z, and then a move up or down that
    brings the ground to -`sensor_height_m`. A return that becomes zero or infinite is dropped. The
    pose stays that of the recording. A scan that `is_level` is moved and not rotated. The result
    is: it is not rotated again.

    Args:
        scan: The returns, sensor at the origin.
        sensor_height_m: The sensor's height above ground, about.

    Returns:
        The levelled scan, `is_level`; `scan` itself where no ground is found.

    Raises:
        InvalidParameters: If `sensor_height_m` is not above 0.

    Examples:
        >>> x, y = np.mgrid[-20.0:21.0, -20.0:21.0].reshape(2, -1)
        >>> tilted = Scan(np.stack([x, y, 0.05 * x - 2.0], axis=1))
        >>> levelled = level(tilted, sensor_height_m=1.8)
        >>> float(np.abs(levelled.points_m[:, 2] + 1.8).max()) < 0.01
        True
    """
    plane = ground_plane(scan.points_m, sensor_height_m)
    if plane is None:
        return scan
    return Scan.from_returns(
        _lifted(scan.points_m, -plane.offset_m - sensor_height_m)
        if scan.is_level
        else _levelled(scan.points_m, plane, sensor_height_m),
        min_returns=0,
        timestamp_s=scan.timestamp_s,
        pose=scan.pose,
        dropped_returns=scan.dropped_returns,
        is_level=True,
    )


def rotation_to_up(normal: tuple[float, float, float]) -> FloatArray:
    """Return the smallest rotation that brings a normal, of length 1 and upwards, to +z, `(3, 3)`.

    Examples:
        >>> normal = (0.6, 0.0, 0.8)
        >>> np.allclose(rotation_to_up(normal) @ normal, [0.0, 0.0, 1.0])
        True
    """
    nx, ny, nz = normal
    across = 1.0 + nz
    xx, xy, yy = 1.0 - nx * nx / across, -(nx * ny) / across, 1.0 - ny * ny / across
    return np.array([[xx, xy, -nx], [xy, yy, -ny], [nx, ny, nz]])


def _levelled(points_m: Float32Array, plane: GroundPlane, sensor_height_m: float) -> Float32Array:
    """Return `(n, 3)` returns above a level plane, infinite where beyond float32."""
    (xx, xy, _), (_, yy, _), (nx, ny, nz) = rotation_to_up(plane.normal).tolist()
    up_m = plane.depth_m - sensor_height_m
    levelled = np.empty_like(points_m, order="C")
    for block in blocks(points_m):
        x, y, z = points_m[block].T.astype(np.float64, order="C")
        out = levelled[block]
        with np.errstate(over="ignore"):
            out[:, 0] = xx * x + xy * y - nx * z
            out[:, 1] = xy * x + yy * y - ny * z
            out[:, 2] = nx * x + ny * y + nz * z + up_m
    return levelled


def _lifted(points_m: Float32Array, up_m: float) -> Float32Array:
    lifted = points_m.copy()
    with np.errstate(over="ignore"):
        lifted[:, 2] = points_m[:, 2].astype(np.float64) + up_m
    return lifted
