"""Which axis of its frame a drive moves along: x, or another one."""

from dataclasses import dataclass

import numpy as np

from core.arrays import FloatArray
from core.scans.pose import is_known, matrices_from_rows

_STEP_M, _LEAST_STEPS = 1.0, 30  # shorter steps have no sure direction, and are added up
_MOST_DEG = 25.0  # between a step and the axis
# A vehicle reverses, and slips to the side, but not all the way.
_LEAST_SHARE = {"+y": 0.9, "-y": 0.9, "-x": 0.97}
_AXES = {"+y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0), "-x": (-1.0, 0.0, 0.0)}
_YAW_DEG = {"+y": -90.0, "-y": 90.0, "-x": 180.0}


@dataclass(frozen=True)
class ForwardAxis:
    """The axis along which a drive moves, where that is not x.

    Attributes:
        axis: `+y`, `-y` or `-x`.
        share: Share of the steps that are along it.
    """

    axis: str
    share: float

    @property
    def yaw_deg(self) -> float:
        """The angle of a mounting that turns the axis forward."""
        return _YAW_DEG[self.axis]


def find_other_forward_axis(poses: FloatArray) -> ForwardAxis | None:
    """Return the axis along which nearly all steps are, `None` if that is x, none or not known.

    Args:
        poses: `(n, 7)` pose rows of one drive, in the order of its scans; NaN where unknown.
    """
    steps = _steps(matrices_from_rows(poses[is_known(poses)]))
    if len(steps) < _LEAST_STEPS:
        return None
    for axis, direction in _AXES.items():
        share = float((steps @ np.array(direction) >= np.cos(np.radians(_MOST_DEG))).mean())
        if share >= _LEAST_SHARE[axis]:
            return ForwardAxis(axis, share)
    return None


def _steps(poses: FloatArray) -> FloatArray:
    """Return the directions of steps of a metre or more in the frames they begin in, `(s, 3)`."""
    steps, first = [], 0
    for at in range(1, len(poses)):
        moved_m = poses[at, :3, 3] - poses[first, :3, 3]
        length_m = float(np.linalg.norm(moved_m))
        if length_m >= _STEP_M:
            steps.append(poses[first, :3, :3].T @ moved_m / length_m)
            first = at
    return np.array(steps).reshape(-1, 3)
