"""Returns that are placed block by block."""

import numpy as np
import pytest

from core.blocks import place_returns


def inside(xyz):
    """Place those right of the sensor in cells of a metre; the value is the height."""
    x, y, z = xyz
    right = y < 0.0
    return np.floor(x[right]).astype(np.int64), z[right]


@pytest.mark.parametrize("returns", [0, 1, 8191, 8192, 8193, 60_000])
def test_blocks_are_placed_as_the_whole_would_be_in_the_order_of_the_returns(returns):
    points_m = np.random.default_rng(0).uniform(-50, 50, (returns, 3)).astype(np.float32)
    cells, values = place_returns(points_m, inside)
    whole_cells, whole_values = inside(points_m.T.astype(np.float64))
    assert cells.tolist() == whole_cells.tolist()
    assert values.tobytes() == whole_values.tobytes()
    assert (str(cells.dtype), str(values.dtype)) == ("int64", "float64")
