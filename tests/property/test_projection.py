"""Every reducer against a loop that defines it (paper, sec. 2.1)."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from core.errors import InvalidScan
from core.projection.range_image import project_scan
from core.projection.reducer import RANGE_REDUCERS, Reducer
from core.scans.scan import Scan
from core.scans.sensor import SENSORS, AngularGrid
from tests.support.samples import sample_points

GRIDS = [
    AngularGrid(),
    AngularGrid(wraps=True),
    AngularGrid(elevation_min_deg=-15.0, elevation_step_deg=2.0, rows=16, azimuth_step_deg=0.5),
    AngularGrid(elevation_min_deg=-90.0, elevation_step_deg=45.0, rows=5, azimuth_step_deg=90.0),
    AngularGrid(-30.0, 10.0, 6, 20.0, wraps=True),
    SENSORS["hdl-32e"].grid,
    SENSORS["os1-64"].grid,
]
coordinates = st.floats(-80, 80, width=32) | st.sampled_from([0.0, -0.0, 1.0, -1.0])
clouds = hnp.arrays(np.float32, st.tuples(st.integers(1, 60), st.just(3)), elements=coordinates)
grids = st.sampled_from(GRIDS)
reducers = st.sampled_from(list(RANGE_REDUCERS))


def cell_of(point, grid):
    """Return the cell of one return, whether it is in the grid, and whether it is near an edge."""
    x, y, z = (float(value) for value in point)
    elevation = math.degrees(math.atan2(z, math.hypot(x, y)))
    azimuth = math.degrees(math.atan2(y, x))
    row_steps = (elevation - grid.elevation_min_deg) / grid.elevation_step_deg
    column_steps = azimuth / grid.azimuth_step_deg
    row, column = round(row_steps), round(column_steps) + round(180 / grid.azimuth_step_deg)
    if grid.wraps:
        column %= grid.columns
    on_edge = any(abs(value % 1.0 - 0.5) < 1e-9 for value in (row_steps, column_steps))
    return (row, column), 0 <= row < grid.rows, on_edge


def slowly_projected(points, grid, reducer):
    """Project with a list in every cell."""
    cells: dict[tuple[int, int], list[float]] = {}
    outside = 0
    for point in points:
        cell, inside, _ = cell_of(point, grid)
        if inside:
            cells.setdefault(cell, []).append(math.hypot(*(float(value) for value in point)))
        else:
            outside += 1
    rules: dict[Reducer, Callable[[list[float]], float]] = {
        Reducer.LAST: lambda ranges: ranges[-1],
        Reducer.NEAREST: min,
        Reducer.FARTHEST: max,
        Reducer.MEAN: lambda ranges: sum(ranges) / len(ranges),
    }
    choose = rules[reducer]
    image = np.zeros(grid.shape)
    for cell, ranges in cells.items():
        image[cell] = choose(ranges)
    return image, outside


def usable(points, grid):
    """Leave out what falls on the edge of two cells: there the last bit of an angle decides."""
    points = points[(points != 0).any(axis=1)]
    keep = [not cell_of(point, grid)[2] for point in points]
    return points[np.array(keep, dtype=bool)]


@given(clouds, grids, reducers)
def test_a_reducer_keeps_what_its_name_means(points, grid, reducer):
    points = usable(points, grid)
    expected, outside = slowly_projected(points, grid, reducer)
    if outside == len(points):
        with pytest.raises(InvalidScan, match=f"none of the {len(points)} returns"):
            project_scan(Scan(points), grid, reducer)
        return
    image = project_scan(Scan(points), grid, reducer)
    np.testing.assert_allclose(image, expected, rtol=1e-6, atol=1e-30)  # of subnormals
    assert image.dtype == np.float32


@given(st.integers(0, 10_000), grids)
def test_all_reducers_but_last_are_independent_of_order(seed, grid):
    points = sample_points(seed, returns=300)
    order = np.random.default_rng(seed).permutation(len(points))
    for reducer in (Reducer.NEAREST, Reducer.FARTHEST):
        np.testing.assert_array_equal(
            project_scan(Scan(points), grid, reducer),
            project_scan(Scan(points[order]), grid, reducer),
        )
    np.testing.assert_allclose(
        project_scan(Scan(points), grid, Reducer.MEAN),
        project_scan(Scan(points[order]), grid, Reducer.MEAN),
        rtol=1e-6,
    )


@given(st.integers(0, 10_000), grids)
def test_nearest_mean_and_farthest_are_in_that_order_and_fill_the_same_cells(seed, grid):
    scan = Scan(sample_points(seed, returns=300))
    nearest, mean, farthest, last = (
        project_scan(scan, grid, reducer)
        for reducer in (Reducer.NEAREST, Reducer.MEAN, Reducer.FARTHEST, Reducer.LAST)
    )
    assert (nearest <= mean * (1 + 1e-6)).all()
    assert (mean <= farthest * (1 + 1e-6)).all()
    assert ((nearest <= last) & (last <= farthest)).all()
    np.testing.assert_array_equal(nearest > 0, farthest > 0)
    np.testing.assert_array_equal(nearest > 0, last > 0)
