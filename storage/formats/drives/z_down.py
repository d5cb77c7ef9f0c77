"""Poses of vehicles whose z is down, x forward and y right, in a world of x north and y east."""

import numpy as np

from core.arrays import FloatArray, frozen

Z_DOWN_TO_Z_UP = frozen(np.diag([1.0, -1.0, -1.0, 1.0]), np.float64)
"""To or from a frame of the same x with y left, or west, and z up."""


def matrices_of(rows: FloatArray) -> FloatArray:
    """Return the `(n, 4, 4)` matrices of poses.

    Args:
        rows: `(n, 6)` x, y, z, roll r, pitch p, heading h, with R = Rz(h) Ry(p) Rx(r).

    Examples:
        >>> matrices_of(np.array([[1.0, 2.0, 3.0, 0.0, 0.0, np.pi / 2]])).round(9)[0].tolist()
        [[0.0, -1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]]
    """
    from scipy.spatial.transform import Rotation  # only such drives need it: decision 33

    matrices = np.broadcast_to(np.eye(4), (len(rows), 4, 4)).copy()
    matrices[:, :3, :3] = Rotation.from_euler("ZYX", rows[:, :2:-1]).as_matrix()
    matrices[:, :3, 3] = rows[:, :3]
    return matrices
