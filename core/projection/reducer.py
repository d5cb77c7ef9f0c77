"""Which return a shared cell of an image keeps, and the reduction of returns to cells."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray
from core.projection.blocks import blocks

MOST_M = 1e30
"""Largest number in a cell: its products with a basis, in float32, stay finite."""

LEAST_M = float(np.finfo(np.float32).tiny)
"""Least number above 0 in a cell, 1.2e-38: a smaller one, subnormal, in a file is a damaged 0."""


class Reducer(StrEnum):
    """Which return a shared cell keeps; the paper leaves it open.

    `highest` is for height images only.
    """

    LAST = "last"
    NEAREST = "nearest"
    FARTHEST = "farthest"
    MEAN = "mean"
    HIGHEST = "highest"


RANGE_REDUCERS = (Reducer.LAST, Reducer.NEAREST, Reducer.FARTHEST, Reducer.MEAN)
HEIGHT_REDUCERS = (Reducer.MEAN, Reducer.HIGHEST)


@dataclass(frozen=True, eq=False)
class Reduced:
    """A scan's returns, reduced to the cells of an image.

    Attributes:
        cells: `(I, J)`, 0 where nothing is or the value is below `LEAST_M`.
        inside: How many returns have a cell.
        largest: The largest of their values, 0 without any.
    """

    cells: Float32Array
    inside: int
    largest: float


def reduce_returns(
    points_m: Float32Array,
    place: Callable[[FloatArray, slice], tuple[IntArray, FloatArray]],
    shape: tuple[int, int],
    reducer: Reducer,
) -> Reduced:
    """Place returns in cells and keep one number a cell.

    Returns are processed in blocks that fit into the cache: all 60,000 at once take twice as long.

    Args:
        points_m: `(n, 3)`.
        place: Turns `(3, m)` coordinates of a slice of the returns into `(k,)` cells and `(k,)`
            values, 0 or more, of those that have a cell, in their order.
        shape: `(I, J)` of the image.
        reducer: What a shared cell keeps.
    """
    count = math.prod(shape)
    sums, counts = np.zeros(count), np.zeros(count, dtype=np.int64)
    kept = np.full(count, np.inf if reducer == Reducer.NEAREST else 0.0, dtype=np.float32)
    inside, largest = 0, 0.0
    for block in blocks(points_m):
        cells, values = place(points_m[block].T.astype(np.float64, order="C"), block)
        if not len(cells):
            continue
        inside += len(cells)
        largest = max(largest, float(values.max()))
        if reducer == Reducer.MEAN:
            np.add.at(sums, cells, values)
            np.add.at(counts, cells, 1)
        else:
            _KEEP[reducer](kept, cells, _float32(values))
    if reducer == Reducer.MEAN:
        kept = _float32(sums / np.maximum(counts, 1))
    # Infinite is empty; callers reject returns above MOST_M.
    kept[np.isinf(kept) | (kept < LEAST_M)] = 0.0
    return Reduced(kept.reshape(shape), inside, largest)


def _overwrite(kept: Float32Array, cells: IntArray, values: Float32Array) -> None:
    # NumPy's tutorial says that the last of repeated indices is kept, its reference promises no
    # order: a test requires the former.
    kept[cells] = values


def _float32(values: FloatArray) -> Float32Array:
    with np.errstate(over="ignore"):  # callers reject what is above MOST_M
        return values.astype(np.float32)


_KEEP: dict[Reducer, Callable[[Float32Array, IntArray, Float32Array], None]] = {
    Reducer.LAST: _overwrite,
    Reducer.NEAREST: np.minimum.at,
    Reducer.FARTHEST: np.maximum.at,
    Reducer.HIGHEST: np.maximum.at,
}
