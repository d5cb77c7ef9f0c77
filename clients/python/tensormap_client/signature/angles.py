"""Angles of returns, rounded to whole steps.

An arctangent takes most of the time of an image. So a polynomial gives nearly all steps, and only
those near the middle between two are computed as signature.md says: the result is the same.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

_OFF_DEG = 1e-4  # more than the polynomial with its rounding is off
# Of the arctangent in degrees, odd powers from the ninth, off by 2e-5 degrees between -1 and 1.
_POWERS = (
    *(0.16237992, -0.9170207, 2.4400902, -4.294574, 6.0944114),
    *(-8.137473, 11.454849, -19.09844, 57.29578),
)


def about_deg(x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the angles of directions to `_OFF_DEG`, NaN or anything nearer to 0 than 1e-30."""
    across, aside = np.abs(x) * np.float32(0.25), np.abs(y) * np.float32(0.25)  # sums are finite
    with np.errstate(all="ignore"):
        tangent = (across - aside) / (across + aside)  # of 45 degrees less the angle
        square = tangent * tangent
        deg = square * np.float32(_POWERS[0])
        for power in _POWERS[1:-1]:
            deg += np.float32(power)
            deg *= square
        deg += np.float32(_POWERS[-1])
        deg *= tangent
        deg += np.float32(45.0)
    np.copysign(deg, x, out=deg)
    np.subtract(np.float32(90.0), deg, out=deg)
    return np.copysign(deg, y, out=deg)


def steps(
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    step_deg: float,
    from_step: float,
    exactly_deg: Callable[[NDArray[np.intp]], NDArray[np.float64]],
) -> NDArray[np.int64]:
    """Return the angles of directions in steps, rounded.

    Args:
        x: The directions' x; they need not have length 1.
        y: The directions' y.
        step_deg: One step.
        from_step: From which steps are counted, a part of one.
        exactly_deg: Computes the exact angles of some directions.
    """
    about = about_deg(x, y)
    about *= np.float32(1.0 / step_deg)
    about -= np.float32(from_step)
    whole = np.rint(about)
    about -= whole
    sure = np.abs(about) < 0.5 - _OFF_DEG / step_deg
    sure &= np.maximum(np.abs(x), np.abs(y)) > 1e-30
    with np.errstate(invalid="ignore"):  # computed below
        found = whole.astype(np.int64)
    left = np.flatnonzero(~sure)
    if len(left):
        found[left] = np.rint(exactly_deg(left) / step_deg - from_step).astype(np.int64)
    return found
