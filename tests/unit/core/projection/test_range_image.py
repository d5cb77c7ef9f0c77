"""Rounding, edges and sensors of the projection (paper, sec. 2.1)."""

import numpy as np
import pytest

from core.errors import InvalidParameters, InvalidScan
from core.projection.range_image import project_scan
from core.projection.reducer import LEAST_M, RANGE_REDUCERS, Reducer
from core.scans.scan import Scan
from core.scans.sensor import SENSORS, AngularGrid, sensor_named

COARSE = AngularGrid(
    elevation_min_deg=-90.0, elevation_step_deg=90.0, rows=3, azimuth_step_deg=90.0
)


def towards(azimuth_deg, elevation_deg, range_m=10.0):
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    return [
        range_m * np.cos(elevation) * np.cos(azimuth),
        range_m * np.cos(elevation) * np.sin(azimuth),
        range_m * np.sin(elevation),
    ]


def only_cell(points, grid=AngularGrid()):  # noqa: B008  # frozen
    image = project_scan(Scan(np.array(points)), grid, Reducer.LAST)
    (cell,) = np.argwhere(image).tolist()
    return tuple(cell)


def test_straight_ahead_is_the_cell_of_elevation_0_and_azimuth_0():
    assert only_cell([[10.0, 0.0, 0.0]]) == (25, 180)


def test_left_is_a_positive_azimuth():
    assert only_cell([[0.0, 5.0, 0.0]]) == (25, 270)
    assert only_cell([[0.0, -5.0, 0.0]]) == (25, 90)


def test_the_last_return_in_order_wins_a_shared_cell_however_many_there_are():
    points = np.zeros((100_000, 3), np.float32)
    points[:, 0] = np.arange(1, 100_001)
    image = project_scan(Scan(points), AngularGrid(), Reducer.LAST)
    assert image[25, 180] == 100_000.0
    image = project_scan(Scan(points[::-1]), AngularGrid(), Reducer.LAST)
    assert image[25, 180] == 1.0


@pytest.mark.parametrize(
    ("y_over_x", "column"),
    [((1.0, 1.0), 2), ((1.0, -1.0), 4), ((-1.0, 1.0), 2), ((-1.0, -1.0), 0)],
)
def test_halves_of_a_step_are_rounded_to_even(y_over_x, column):
    # 45 deg is exactly half a step of 90, 135 one and a half.
    y, x = y_over_x
    assert only_cell([[x, y, 0.0]], COARSE) == (1, column)


@pytest.mark.parametrize(("z", "row"), [(1.0, 1), (-1.0, 1), (1.1, 2), (-1.1, 0)])
def test_halves_of_an_elevation_step_are_rounded_to_even(z, row):
    assert only_cell([[1.0, 0.0, z]], COARSE) == (row, 2)


def test_straight_up_and_down_have_an_elevation():
    assert only_cell([[0.0, 0.0, 3.0]], COARSE)[0] == 2
    assert only_cell([[0.0, 0.0, -3.0]], COARSE)[0] == 0


def test_the_direction_behind_is_split_in_half_on_the_papers_grid():
    assert only_cell([[-10.0, 0.05, 0.0]]) == (25, 360)
    assert only_cell([[-10.0, 0.0, 0.0]]) == (25, 360)
    assert only_cell([[-10.0, -0.0, 0.0]]) == (25, 0)
    assert only_cell([[-10.0, -0.05, 0.0]]) == (25, 0)


def test_a_grid_that_wraps_joins_both_halves():
    grid = AngularGrid(wraps=True)
    for y in (0.05, 0.0, -0.0, -0.05):
        assert only_cell([[-10.0, y, 0.0]], grid) == (25, 0)
    assert only_cell([towards(179.0, 0.0)], grid) == (25, 359)


def test_returns_outside_the_grid_are_left_out():
    points = [[10.0, 0.0, 0.0], towards(0.0, 4.6), towards(0.0, -25.6), [0.0, 0.0, 1.0]]
    image = project_scan(Scan(np.array(points)), AngularGrid(), Reducer.MEAN)
    assert np.count_nonzero(image) == 1


@pytest.mark.parametrize("reducer", RANGE_REDUCERS)
def test_a_scan_of_ranges_next_to_0_is_rejected(reducer):
    with pytest.raises(InvalidScan, match=r"none of the 1 returns gives a range of 1\.2e-38 m"):
        project_scan(Scan(np.array([[1e-40, 0.0, 0.0]])), AngularGrid(), reducer)


def test_a_scan_wholly_outside_the_grid_is_rejected_with_the_reason():
    with pytest.raises(InvalidScan, match=r"none of the 1 returns .* -25\.\.4 deg"):
        project_scan(Scan(np.array([[0.0, 0.0, 5.0]])), AngularGrid(), Reducer.LAST)


@pytest.mark.parametrize("reducer", list(RANGE_REDUCERS))
def test_returns_whose_range_a_cell_cannot_hold_make_an_invalid_scan(reducer):
    for far_m in (3.4e38, 1.1e30):
        beyond = Scan(np.full((1, 3), [far_m, far_m, 0.0], dtype=np.float32))
        with pytest.raises(InvalidScan, match=r"a return is .* away, wanted less than 1e\+30"):
            project_scan(beyond, AngularGrid(), reducer)


def test_the_smallest_and_largest_ranges_are_kept():
    for metres in (LEAST_M, 9.9e29):
        scan = Scan(np.array([[metres, 0.0, 0.0]], dtype=np.float32))
        for reducer in RANGE_REDUCERS:
            assert project_scan(scan, AngularGrid(), reducer)[25, 180] == np.float32(metres)


def test_a_reducer_may_be_named_by_its_text():
    scan = Scan(np.array([[10.0, 0.0, 0.0], [12.0, 0.0, 0.0]]))
    for reducer in RANGE_REDUCERS:
        named = project_scan(scan, AngularGrid(), str(reducer))  # type: ignore[arg-type]  # as JSON has it
        np.testing.assert_array_equal(named, project_scan(scan, AngularGrid(), reducer))


@pytest.mark.parametrize("name", sorted(SENSORS))
@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, -37.0])
def test_each_beam_of_a_sensor_lands_in_its_own_row(name, azimuth_deg):
    grid = SENSORS[name].grid
    for row, elevation_deg in enumerate(grid.elevations_deg.tolist()):
        assert only_cell([towards(azimuth_deg, elevation_deg)], grid) == (
            row,
            180 + round(azimuth_deg),
        )


@pytest.mark.parametrize("step_deg", [0.25, 0.5, 1.0, 2.0, 20.0, 90.0])
def test_each_azimuth_of_a_grid_lands_in_its_own_column(step_deg):
    for wraps in (False, True):
        grid = AngularGrid(azimuth_step_deg=step_deg, wraps=wraps)
        inner = range(1, grid.columns - 1)
        cells = [only_cell([towards(grid.azimuths_deg[j], 0.0)], grid) for j in list(inner)[:40]]
        assert cells == [(25, j) for j in list(inner)[:40]]


def test_a_sensor_is_named_in_any_case_and_an_unknown_one_lists_the_others():
    assert sensor_named("HDL-64E") is SENSORS["hdl-64e"]
    with pytest.raises(InvalidParameters, match="no sensor 'radar'; known are avia, hap, hdl-32e"):
        sensor_named("radar")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"elevation_step_deg": 0.0}, r"elevation_step_deg is 0.0, wanted 0.001..90"),
        ({"elevation_step_deg": np.nan}, "elevation_step_deg is nan"),
        ({"azimuth_step_deg": -1.0}, "azimuth_step_deg is -1.0"),
        ({"azimuth_step_deg": 0.7}, "does not divide 180"),
        ({"azimuth_step_deg": 5e-324}, "azimuth_step_deg is 5e-324"),
        ({"azimuth_step_deg": 1e-3}, "cells"),
        ({"azimuth_step_deg": np.inf}, "azimuth_step_deg is inf"),
        ({"elevation_min_deg": -91.0}, "elevation_min_deg is -91.0"),
        ({"elevation_min_deg": np.nan}, "elevation_min_deg is nan"),
        ({"rows": 0}, "rows is 0"),
        ({"rows": 2.5}, "rows is 2.5"),
        ({"rows": np.nan}, "rows is nan"),
        ({"rows": 10**30}, "rows is 10000"),
        ({"rows": 117}, "highest elevation is 91"),
    ],
)
def test_an_invalid_grid_is_rejected_by_name(wrong, message):
    with pytest.raises(InvalidParameters, match=message):
        AngularGrid(**wrong)


def test_a_grid_of_whole_numbers_is_the_grid_of_the_same_decimals():
    whole = AngularGrid(-25, 1, np.int64(30), 1, wraps=np.False_)  # type: ignore[arg-type]
    assert whole == AngularGrid()
    assert repr(whole.as_attributes()) == repr(AngularGrid().as_attributes())
