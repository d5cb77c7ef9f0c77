"""Arithmetic on returns, block by block."""

from collections.abc import Callable

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray

__all__ = ["place_returns"]

_RETURNS = 8192  # 64 kB a number: the ten or so that a projection works with stay in the cache


def place_returns(
    points_m: Float32Array, place: Callable[[FloatArray], tuple[IntArray, FloatArray]]
) -> tuple[IntArray, FloatArray]:
    """Return the cell and the value of each return that has one, in the returns' order.

    A block at a time this takes half as long as on a whole scan of 60,000 returns, whose numbers
    would go to memory and back at every step.

    Args:
        points_m: `(n, 3)`.
        place: Turns `(3, m)` coordinates into `(k,)` cells and `(k,)` values, of those that have
            one.
    """
    parts = [
        place(points_m[at : at + _RETURNS].T.astype(np.float64, order="C"))
        for at in range(0, max(1, len(points_m)), _RETURNS)
    ]
    cells, values = zip(*parts, strict=True)
    return np.concatenate(cells), np.concatenate(values)
