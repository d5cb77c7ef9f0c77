"""The level frame of a sensor that is fixed to its vehicle."""

import numpy as np

from core.arrays import FloatArray, IntArray
from core.errors import InvalidScan
from core.projection.ground import ground_plane
from core.projection.levelling import rotation_to_up
from core.scans.drive import Drive


def level_frame(drive: Drive, grounds: IntArray, sensor_height_m: float) -> FloatArray:
    """Return the rotation of the sensor's frame that makes it level, `(4, 4)`.

    The smallest one that brings the ground's normal to +z, of the median of some scans: a sensor is
    fixed to its vehicle.

    Args:
        drive: The recording.
        grounds: Positions of the scans in which the ground is looked for.
        sensor_height_m: Above ground, about.
    """
    normals = []
    for at in grounds.tolist():
        try:
            plane = ground_plane(drive.scan(at).points_m, sensor_height_m)
        except InvalidScan:
            continue
        if plane is not None:
            normals.append(plane.normal)
    level = np.eye(4)
    if normals:
        nx, ny, _ = np.median(normals, axis=0)
        level[:3, :3] = rotation_to_up((nx, ny, np.sqrt(1.0 - nx * nx - ny * ny)))
    return level
