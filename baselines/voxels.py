"""Thinning of returns: one for each occupied cube."""

import numpy as np

from core.arrays import Float32Array, FloatArray


def voxel_means(points_m: Float32Array, side_m: float) -> FloatArray:
    """Return the mean of the returns in each occupied cube of a grid, `(n, 3)`.

    Examples:
        >>> pair = np.array([[0.1, 0.1, 0.1], [0.3, 0.1, 0.1], [5.0, 0.1, 0.1]], np.float32)
        >>> voxel_means(pair, 0.5).round(6).tolist()
        [[0.2, 0.1, 0.1], [5.0, 0.1, 0.1]]
    """
    points = points_m.astype(np.float64)
    cubes = np.floor(points / side_m).astype(np.int64)
    cubes -= cubes.min(axis=0)
    sizes = cubes.max(axis=0) + 1
    if float(np.prod(sizes.astype(np.float64))) < 2.0**62:
        flat = (cubes[:, 0] * sizes[1] + cubes[:, 1]) * sizes[2] + cubes[:, 2]
        _, cube = np.unique(flat, return_inverse=True)
    else:  # too many cubes to number them
        _, cube = np.unique(cubes, axis=0, return_inverse=True)
    cube = cube.ravel()
    counts = np.bincount(cube)
    sums = [np.bincount(cube, weights=axis) for axis in points.T]
    return np.stack(sums, axis=1) / counts[:, None]
