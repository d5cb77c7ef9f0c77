"""Height images, rings, and what a scan looks like from beside."""

import numpy as np
import pytest

from core.errors import InvalidParameters, InvalidScan
from core.projection.height_image import project_heights
from core.projection.reducer import HEIGHT_REDUCERS, Reducer
from core.projection.rings import RingGrid
from core.scans.scan import Scan
from tests.support.samples import sample_points

HEIGHT_M = 1.73


def by_loop(points_m, grid, reducer, height_m):
    """Return the image as its definition reads, return by return."""
    cells: dict[tuple[int, int], list[float]] = {}
    for x, y, z in points_m.astype(np.float64).tolist():
        ring = int((x * x + y * y) ** 0.5 // grid.ring_m)
        azimuth = round(float(np.degrees(np.arctan2(y, x))) / grid.azimuth_step_deg) % grid.columns
        if ring < grid.rings:
            cells.setdefault((ring, azimuth), []).append(max(0.0, z + height_m))
    image = np.zeros(grid.shape)
    for cell, heights in cells.items():
        image[cell] = max(heights) if reducer == Reducer.HIGHEST else np.mean(heights)
    return image


@pytest.mark.parametrize("reducer", HEIGHT_REDUCERS)
@pytest.mark.parametrize("grid", [RingGrid(), RingGrid(10.0, 3, 30.0)])
def test_a_height_image_is_that_of_a_loop_over_the_returns(reducer, grid):
    for seed in range(5):
        points = sample_points(seed, 500)
        image = project_heights(Scan(points), grid, reducer, HEIGHT_M)
        np.testing.assert_allclose(image, by_loop(points, grid, reducer, HEIGHT_M), rtol=1e-6)
        shuffled = Scan(np.random.default_rng(0).permutation(points))
        again = project_heights(shuffled, grid, reducer, HEIGHT_M)
        np.testing.assert_allclose(again, image, rtol=1e-6)


def test_rings_are_half_open_and_what_lies_beyond_the_last_is_left_out():
    points = np.array([[3.999, 0, 0], [4.0, 0, 0], [79.99, 0, 0], [80.0, 0, 0], [200.0, 0, 0]])
    image = project_heights(Scan(points), RingGrid(), Reducer.HIGHEST, 1.0)
    assert np.flatnonzero(image[:, 0]).tolist() == [0, 1, 19]


@pytest.mark.parametrize(
    ("azimuth_deg", "column"), [(0, 0), (-0.4, 0), (1, 1), (-1, 359), (180, 180), (-179.9, 180)]
)
def test_azimuths_are_counted_from_ahead_and_the_image_has_no_seam(azimuth_deg, column):
    phi = np.radians(azimuth_deg)
    point = [[10 * np.cos(phi), 10 * np.sin(phi), 1.0]]
    image = project_heights(Scan(np.array(point)), RingGrid(), Reducer.MEAN, 1.0)
    assert np.argwhere(image).tolist() == [[2, column]]


def test_what_lies_below_the_ground_is_on_it():
    points = np.array([[10.0, 0.0, -5.0], [10.0, 0.0, 1.0]])
    mean = project_heights(Scan(points), RingGrid(), Reducer.MEAN, 2.0)
    assert mean[2, 0] == np.float32(1.5)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[100.0, 0.0, 0.0]], "within 80 m: are they in the frame of a map, or millimetres"),
        ([[10.0, 0.0, -3.0]], "above the ground, which is 1.73 m below the sensor"),
        ([[1e38, 1e38, 0.0]], "within 80 m"),
    ],
)
def test_a_scan_without_a_height_is_rejected(points, message):
    with pytest.raises(InvalidScan, match=message):
        project_heights(Scan(np.array(points)), RingGrid(), Reducer.MEAN, 1.73)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ring_m": 0.0}, "ring_m"),
        ({"ring_m": float("nan")}, "ring_m"),
        ({"rings": 0}, "rings"),
        ({"rings": 2.5}, "rings"),
        ({"rings": 10**6}, "cells"),
        ({"azimuth_step_deg": 7.0}, "does not divide 180"),
    ],
)
def test_invalid_rings_are_rejected(changes, message):
    with pytest.raises(InvalidParameters, match=message):
        RingGrid(**changes)


def test_equal_rings_are_one_grid_however_they_are_written():
    assert RingGrid(4, 20, 1) == RingGrid()
    assert RingGrid(4, 20, 1).as_attributes() == {
        "ring_m": 4.0,
        "rings": 20,
        "azimuth_step_deg": 1.0,
    }
