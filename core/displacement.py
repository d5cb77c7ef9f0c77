"""What is seen, and where one is, beside a recorded place and turned."""

import numpy as np
from scipy.spatial.transform import Rotation

from core.arrays import Float32Array, FloatArray

__all__ = ["left_of_m", "pose_beside", "seen_from_beside"]


def seen_from_beside(
    points_m: Float32Array | FloatArray, left_m: float, turn_deg: float = 0.0, ahead_m: float = 0.0
) -> FloatArray:
    """Return points as a sensor sees them that stands to the left and ahead, and is then turned.

    p' = Rz(-turn) (p - (ahead, left, 0)), the turn counter-clockwise. The points are those seen
    from the recorded place: what only the displaced sensor would see is missing.

    Examples:
        >>> seen_from_beside(np.array([[10.0, 5.0, 0.0]]), 5.0, 90.0).round(3).tolist()
        [[0.0, -10.0, 0.0]]
    """
    points = points_m.astype(np.float64) - (ahead_m, left_m, 0.0)
    return np.asarray(Rotation.from_euler("z", -turn_deg, degrees=True).apply(points))


def pose_beside(
    row: FloatArray, left_m: float, turn_deg: float = 0.0, ahead_m: float = 0.0
) -> FloatArray:
    """Return the `(7,)` pose row of that sensor, of the `(7,)` row of the recorded place.

    An unknown row (NaN) stays unknown.

    Examples:
        >>> north = np.array([1.0, 2.0, 0.0, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
        >>> pose_beside(north, left_m=3.0, turn_deg=-90.0).round(3).tolist()
        [-2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    """
    if not np.isfinite(row).all():
        return np.full(7, np.nan)
    recorded = Rotation.from_quat(row[3:])
    turned = recorded * Rotation.from_euler("z", turn_deg, degrees=True)
    position_m = row[:3] + recorded.apply([ahead_m, left_m, 0.0])
    return np.concatenate([position_m, turned.as_quat(canonical=True)])


def left_of_m(place: FloatArray, other: FloatArray) -> float:
    """Return how far to the left of one `(7,)` pose row another lies, negative right.

    NaN if one of them is unknown.

    Examples:
        >>> north = np.array([1.0, 2.0, 0.0, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
        >>> round(left_of_m(north, pose_beside(north, left_m=3.0, turn_deg=70.0)), 9)
        3.0
    """
    if not (np.isfinite(place).all() and np.isfinite(other).all()):
        return float("nan")
    return float(Rotation.from_quat(place[3:]).inv().apply(other[:3] - place[:3])[1])
