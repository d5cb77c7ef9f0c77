"""Differences of directions, taken the short way round."""

import math
from typing import TypeVar

from core.arrays import FloatArray

_Angle = TypeVar("_Angle", float, FloatArray)


def wrapped_deg(angle_deg: _Angle) -> _Angle:
    """Return angles in degrees brought into -180 (included) to 180.

    Examples:
        >>> wrapped_deg(350.0), wrapped_deg(-190.0), wrapped_deg(180.0)
        (-10.0, 170.0, -180.0)
    """
    return (angle_deg + 180.0) % 360.0 - 180.0


def wrapped_rad(angle: _Angle) -> _Angle:
    """Return angles in radians brought into -pi (included) to pi."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
