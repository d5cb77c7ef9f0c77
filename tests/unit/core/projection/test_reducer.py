"""Returns that come to their cells block by block."""

from collections.abc import Callable

import numpy as np
import pytest

from core.arrays import FloatArray
from core.projection.reducer import LEAST_M, Reducer, reduce_returns


def cells_and_heights(xyz):
    """Place those right of the sensor in cells of a metre; the value is the height."""
    x, y, z = xyz
    right = y < 0.0
    return np.floor(np.abs(x[right])).astype(np.int64), np.abs(z[right])


RULES: dict[Reducer, Callable[[FloatArray], float]] = {
    Reducer.LAST: lambda values: values[-1],
    Reducer.NEAREST: min,
    Reducer.FARTHEST: max,
    Reducer.HIGHEST: max,
    Reducer.MEAN: lambda values: np.cumsum(values)[-1] / len(values),
}


@pytest.mark.parametrize("returns", [0, 1, 8191, 8192, 8193, 20_000])
@pytest.mark.parametrize("reducer", Reducer)
def test_a_cell_keeps_what_it_would_of_all_returns_at_once_in_their_order(returns, reducer):
    points_m = np.random.default_rng(0).uniform(-50, 50, (returns, 3)).astype(np.float32)
    reduced = reduce_returns(points_m, lambda xyz, _: cells_and_heights(xyz), (6, 10), reducer)
    cells, values = cells_and_heights(points_m.T.astype(np.float64))
    expected = np.zeros(60, np.float32)
    for cell in np.unique(cells).tolist():
        expected[cell] = RULES[reducer](values[cells == cell])
    assert reduced.cells.ravel().tolist() == expected.tolist()
    assert reduced.cells.dtype == np.float32
    assert (reduced.inside, reduced.largest) == (len(cells), values.max(initial=0.0))


@pytest.mark.parametrize("reducer", Reducer)
def test_no_cell_has_a_subnormal_number(reducer):
    points_m = np.array([[0.5, -1.0, 1e-40], [1.5, -1.0, LEAST_M], [2.5, -1.0, 3.0]], np.float32)
    reduced = reduce_returns(points_m, lambda xyz, _: cells_and_heights(xyz), (1, 4), reducer)
    assert reduced.cells.ravel().tolist() == [0.0, LEAST_M, 3.0, 0.0]
