"""Which return a shared cell of an image keeps, and how a scan's returns come to their cells."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray

_BLOCK = 8192  # returns; 64 kB a number: the ten or so that a projection works with stay in cache


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
    """What is left of a scan's returns in the cells of an image.

    Attributes:
        cells: `(I, J)`, 0 where nothing is.
        inside: How many returns have a cell.
        largest: The largest of their values, 0 without any.
    """

    cells: Float32Array
    inside: int
    largest: float


def reduce_returns(
    points_m: Float32Array,
    place: Callable[[FloatArray], tuple[IntArray, FloatArray]],
    shape: tuple[int, int],
    reducer: Reducer,
) -> Reduced:
    """Place returns in cells and keep one number a cell.

    The returns go block by block: all at once the numbers of 60,000 would go to memory and back
    at every step, which takes twice as long.

    Args:
        points_m: `(n, 3)`.
        place: Turns `(3, m)` coordinates into `(k,)` cells and `(k,)` values, 0 or more, of those
            returns that have a cell, in their order.
        shape: `(I, J)` of the image.
        reducer: What a shared cell keeps.
    """
    reduction = _REDUCTIONS[reducer](math.prod(shape))
    inside, largest = 0, 0.0
    for at in range(0, len(points_m), _BLOCK):
        cells, values = place(points_m[at : at + _BLOCK].T.astype(np.float64, order="C"))
        if len(cells):
            inside += len(cells)
            largest = max(largest, float(values.max()))
            reduction.add(cells, values)
    return Reduced(reduction.cells().reshape(shape), inside, largest)


class _Mean:
    """The mean of a cell's returns."""

    def __init__(self, cell_count: int) -> None:
        self._sums, self._counts = np.zeros(cell_count), np.zeros(cell_count, dtype=np.int64)

    def add(self, cells: IntArray, values: FloatArray) -> None:
        np.add.at(self._sums, cells, values)
        np.add.at(self._counts, cells, 1)

    def cells(self) -> Float32Array:
        return _float32(self._sums / np.maximum(self._counts, 1))


class _Kept:
    """One return's number a cell: `keep` is given the cells so far, then indices and values."""

    def __init__(
        self,
        cell_count: int,
        keep: Callable[[Float32Array, IntArray, Float32Array], None],
        empty: float = 0.0,
    ) -> None:
        self._cells = np.full(cell_count, empty, dtype=np.float32)
        self._keep, self._empty = keep, empty

    def add(self, cells: IntArray, values: FloatArray) -> None:
        self._keep(self._cells, cells, _float32(values))

    def cells(self) -> Float32Array:
        return np.where(self._cells == self._empty, np.float32(0.0), self._cells)


def _overwrite(kept: Float32Array, cells: IntArray, values: Float32Array) -> None:
    # NumPy's tutorial says that the last of repeated indices is kept, its reference promises no
    # order: a test holds it to the former.
    kept[cells] = values


def _float32(values: FloatArray) -> Float32Array:
    with np.errstate(over="ignore"):  # who projects refuses what is beyond float32
        return values.astype(np.float32)


_REDUCTIONS: dict[Reducer, Callable[[int], _Mean | _Kept]] = {
    Reducer.LAST: lambda cell_count: _Kept(cell_count, _overwrite),
    Reducer.NEAREST: lambda cell_count: _Kept(cell_count, np.minimum.at, empty=np.inf),
    Reducer.FARTHEST: lambda cell_count: _Kept(cell_count, np.maximum.at),
    Reducer.HIGHEST: lambda cell_count: _Kept(cell_count, np.maximum.at),
    Reducer.MEAN: _Mean,
}
