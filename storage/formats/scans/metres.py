"""Whether returns can be metres from the sensor: not millimetres, nor coordinates of a map."""

import numpy as np

from core.arrays import Float32Array
from storage.formats.errors import WrongDtype

LARGEST_MEDIAN_M = 500.0
"""Lidars of vehicles measure less far. Half of a scan's returns are within some 20 m, and in a room
beyond 1000 mm."""
_SAMPLED = 1000  # returns


def require_metres(returns_m: Float32Array) -> None:
    """Reject `(n, 3)` returns of which half are farther away than a lidar measures.

    Raises:
        WrongDtype: If they are.

    Examples:
        >>> require_metres(np.array([[12.0, 5.0, -1.7]], np.float32))
        >>> require_metres(np.array([[12000.0, 5000.0, -1700.0]], np.float32))
        Traceback (most recent call last):
        storage.formats.errors.WrongDtype: half of the returns are 12000 m away or more, ...
    """
    if not len(returns_m):
        return
    sample = returns_m[:: -(-len(returns_m) // _SAMPLED)]
    away_m = np.abs(sample).max(axis=1)
    middle = len(away_m) // 2
    median_m = float(np.partition(away_m, middle)[middle])  # `np.median` takes five times as long
    if median_m > LARGEST_MEDIAN_M:
        raise WrongDtype(
            f"half of the returns are {median_m:.6g} m away or more, a lidar measures within"
            f" {LARGEST_MEDIAN_M:g} m: are these millimetres, or a map's coordinates? Wanted metres"
            " in the sensor's frame"
        )
