"""Whether the vehicle is stationary: such errors are counted separately (paper, sec. 3.3)."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from core.arrays import BoolArray, FloatArray
from core.scans.angles import wrapped_rad
from core.scans.pose import is_known, matrices_from_rows
from core.scans.rigid import inverse, rotation_deg

_T = TypeVar("_T", bound=np.generic)

NOMINAL_PERIOD_S = 0.1  # the paper's sensor rotates at 10 Hz
STANDING = 0.05  # metres and radians per nominal period: 0.5 m/s, 29 degrees/s


def is_standing(poses: FloatArray, timestamp_s: FloatArray) -> BoolArray:
    """Return which scans were recorded while stationary: a change of less than 0.05 x (dt / 0.1 s).

    The change is the norm of the metres moved and the radians turned since the previous scan; for
    the first scan, to the next. It is the surrogate, but for a turn by one angle: roll and yaw of a
    sensor that looks up are not known apart. Where a time is unknown dt is 0.1 s; where a pose is
    unknown the vehicle counts as moving.

    Args:
        poses: `(K, 7)`.
        timestamp_s: `(K,)`.
    """
    moved_m = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
    matrices = matrices_from_rows(poses)
    turned = np.radians(rotation_deg(inverse(matrices[:-1]) @ matrices[1:]))
    period_s = np.diff(timestamp_s)
    period_s = np.where(np.isfinite(period_s) & (period_s > 0), period_s, NOMINAL_PERIOD_S)
    standing = np.hypot(moved_m, turned) < STANDING * (period_s / NOMINAL_PERIOD_S)
    return _since_previous(standing, len(poses), alone=False)


def motion_surrogate(poses: FloatArray) -> FloatArray:
    """Return the paper's surrogate of speed, `(K,)`: the norm of the change in 6-DOF pose.

    The six are x, y, z in metres and roll, pitch, yaw in radians, as in the Ford dataset;
    differences of angles are wrapped. NaN where a pose is unknown.
    """
    known = is_known(poses)
    angles = np.full((len(poses), 3), np.nan)
    if known.any():
        # Of a sensor that looks straight up or down yaw is taken as 0.
        rotations = Rotation.from_quat(poses[known, 3:])
        angles[known] = rotations.as_euler("xyz", suppress_warnings=True)
    turned = wrapped_rad(np.diff(angles, axis=0))
    change = np.hstack([np.diff(poses[:, :3], axis=0), turned])
    return _since_previous(np.linalg.norm(change, axis=1), len(poses), alone=np.nan)


def _since_previous(steps: NDArray[_T], scans: int, alone: float) -> NDArray[_T]:
    """Repeat the first step for the first scan; a scan `alone` has none."""
    first = steps[:1] if len(steps) else np.array([alone], dtype=steps.dtype)
    return np.concatenate([first, steps])[:scans]
