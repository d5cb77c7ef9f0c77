"""Angles of returns, rounded to whole steps, without an arctan for each.

Angles are half of the time of a projection. A polynomial in single precision gives nearly all of
them; the few that are within its error of the middle between two steps are computed in double
precision. The steps are exactly those of `np.arctan2` and `np.arctan`.
"""

from collections.abc import Callable

import numpy as np
from numpy.polynomial import chebyshev

from core.arrays import Float32Array, FloatArray, IntArray
from core.projection.blocks import blocks

_DEGREE = 8
# The polynomial is off by 2e-5 degrees at most, rounding adds as much (a property test checks it).
_OFF_DEG = 1e-4


def _arctan_coefficients() -> list[np.float32]:
    """Return those of arctan(t) / t, in degrees, by powers of t squared from 0 to 1."""
    nodes = 0.5 + 0.5 * chebyshev.chebpts1(64)
    t = np.sqrt(nodes)
    fitted = np.polynomial.Polynomial.fit(nodes, np.degrees(np.arctan(t)) / t, _DEGREE)
    return [np.float32(number) for number in fitted.convert().coef]


_ARCTAN = _arctan_coefficients()


def azimuth_steps(x: FloatArray, y: FloatArray, step_deg: float) -> IntArray:
    """Return the azimuths of `(n,)` horizontal coordinates, in steps, rounded: -180 to 180 degrees.

    Examples:
        >>> azimuth_steps(np.array([1.0, 0.0, -1.0]), np.array([0.0, 2.0, 1.0]), 0.5).tolist()
        [0, 180, 270]
    """
    about_deg = _first_quadrant_deg(np.abs(x), np.abs(y))
    np.subtract(np.float32(90.0), about_deg, out=about_deg)
    np.copysign(about_deg, x, out=about_deg, casting="same_kind")
    np.subtract(np.float32(90.0), about_deg, out=about_deg)
    np.copysign(about_deg, y, out=about_deg, casting="same_kind")
    return _rounded(about_deg, step_deg, 0.0, lambda left: np.degrees(np.arctan2(y[left], x[left])))


def azimuth_columns(points_m: Float32Array, columns: int) -> IntArray:
    """Return in which of J columns around the sensor each of `(n, 3)` returns is, `(n,)`.

    Column 0 is in the middle of the first step, ahead; columns go counter-clockwise.

    Examples:
        >>> azimuth_columns(np.float32([[5.0, 0.1, 0.0], [0.0, -3.0, 1.0]]), 360).tolist()
        [1, 270]
    """
    found = np.empty(len(points_m), dtype=np.int64)
    for block in blocks(points_m):
        x, y = points_m[block, :2].T.astype(np.float64, order="C")
        found[block] = columns_of_steps(azimuth_steps(x, y, 360.0 / columns), columns)
    return found


def columns_of_steps(steps: IntArray, columns: int) -> IntArray:
    """Return the columns of azimuths in steps of 360 / J degrees, in their own memory."""
    return np.add(steps, columns, out=steps, where=steps < 0)  # a fourth of the time of `%`


def elevation_steps(
    across: FloatArray, up: FloatArray, step_deg: float, first_step: float = 0.0
) -> IntArray:
    """Return the elevations of `(n,)` horizontal distances and heights, in steps, rounded.

    Args:
        across: Horizontal distances, 0 or more; with 0 the elevation is 90 degrees, up or down.
        up: z, not 0 where `across` is.
        step_deg: One step.
        first_step: The angle from which steps are counted, a part of one step.

    Examples:
        >>> elevation_steps(np.array([1.0, 0.0]), np.array([1.0, 5.0]), 2.0, 1.4).tolist()
        [21, 44]
    """
    about_deg = _first_quadrant_deg(across, np.abs(up))
    np.copysign(about_deg, up, out=about_deg, casting="same_kind")

    def exactly_deg(left: IntArray) -> FloatArray:
        with np.errstate(divide="ignore", invalid="ignore"):  # straight up is arctan(inf)
            return np.asarray(np.degrees(np.arctan(up[left] / across[left])))

    return _rounded(about_deg, step_deg, first_step, exactly_deg)


def _first_quadrant_deg(across: FloatArray, aside: FloatArray) -> Float32Array:
    """Return approximate angles in the first quadrant, NaN at the origin."""
    with np.errstate(invalid="ignore"):
        t = ((across - aside) / (across + aside)).astype(np.float32)  # the tangent of 45 less it
    squared = t * t
    deg = squared * _ARCTAN[-1]
    for coefficient in _ARCTAN[-2:0:-1]:
        deg += coefficient
        deg *= squared
    deg += _ARCTAN[0]
    deg *= t
    np.subtract(np.float32(45.0), deg, out=deg)
    return deg


def _rounded(
    about_deg: Float32Array,
    step_deg: float,
    first_step: float,
    exactly_deg: Callable[[IntArray], FloatArray],
) -> IntArray:
    """Round; compute exactly what is too close to the middle between two steps."""
    about_deg *= np.float32(1.0 / step_deg)
    about_deg -= np.float32(first_step)
    whole = np.rint(about_deg)
    about_deg -= whole
    np.abs(about_deg, out=about_deg)
    with np.errstate(invalid="ignore"):  # NaN, and steps too many for int32: computed below
        steps = whole.astype(np.int32).astype(np.int64)  # twice as fast as at once
    left = np.flatnonzero(~(about_deg < 0.5 - _OFF_DEG / step_deg))
    if len(left):
        steps[left] = np.rint(exactly_deg(left) / step_deg - first_step).astype(np.int64)
    return steps
