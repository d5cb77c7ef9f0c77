"""Which axis of the world of a drive's poses points up: z, or another one."""

from dataclasses import dataclass

import numpy as np

from core.arrays import FloatArray
from core.scans.pose import is_known, matrices_from_rows

_LEAST_POSES = 3
_MOST_DEG = 40.0  # between an axis and up: hills, and a sensor that is tilted on its vehicle
_LEAST_SHARE = 0.9  # of the poses
_AXES = {
    "-z": (0.0, 0.0, -1.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
}


@dataclass(frozen=True)
class WorldUp:
    """The axis of a world that points up, where that is not z.

    Attributes:
        axis: `-z`, `+y`, `-y`, `+x` or `-x`.
        share: Share of the poses that show it.
    """

    axis: str
    share: float


def find_other_world_up(poses: FloatArray) -> WorldUp | None:
    """Return the axis of the world to which nearly all poses turn z, `None` if that is z or none.

    The motion from scan to scan is the same in each world, so that no scan contradicts such poses.

    Args:
        poses: `(n, 7)` pose rows of one drive in whose frame z is up; NaN where unknown.

    Examples:
        >>> rolled = np.tile([0.0, 0.0, 0.0, -(0.5**0.5), 0.0, 0.0, 0.5**0.5], (3, 1))
        >>> find_other_world_up(rolled)
        WorldUp(axis='+y', share=1.0)
    """
    up = matrices_from_rows(poses[is_known(poses)])[:, :3, 2]
    if len(up) < _LEAST_POSES:
        return None
    for axis, direction in _AXES.items():
        share = float((up @ np.array(direction) >= np.cos(np.radians(_MOST_DEG))).mean())
        if share >= _LEAST_SHARE:
            return WorldUp(axis, share)
    return None
