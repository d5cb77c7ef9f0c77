"""Height images, rings, and what a scan looks like from beside."""

import numpy as np
import pytest

from core.errors import InvalidImage, InvalidParameters, InvalidScan
from core.projection.height_image import HeightImage, project_heights
from core.projection.imager import ImageKind, Imager
from core.projection.range_image import project_scan
from core.projection.reducer import HEIGHT_REDUCERS, RANGE_REDUCERS, Reducer
from core.projection.rings import RingGrid
from core.scans.scan import Scan
from core.scans.sensor import AngularGrid
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
        np.testing.assert_allclose(
            image.heights_m, by_loop(points, grid, reducer, HEIGHT_M), rtol=1e-6
        )
        shuffled = Scan(np.random.default_rng(0).permutation(points))
        again = project_heights(shuffled, grid, reducer, HEIGHT_M)
        np.testing.assert_allclose(again.heights_m, image.heights_m, rtol=1e-6)


def test_rings_are_half_open_and_what_lies_beyond_the_last_is_left_out():
    points = np.array([[3.999, 0, 0], [4.0, 0, 0], [79.99, 0, 0], [80.0, 0, 0], [200.0, 0, 0]])
    image = project_heights(Scan(points), RingGrid(), Reducer.HIGHEST, 1.0)
    assert np.flatnonzero(image.heights_m[:, 0]).tolist() == [0, 1, 19]


@pytest.mark.parametrize(
    ("azimuth_deg", "column"), [(0, 0), (-0.4, 0), (1, 1), (-1, 359), (180, 180), (-179.9, 180)]
)
def test_azimuths_are_counted_from_ahead_and_a_turn_has_no_seam(azimuth_deg, column):
    phi = np.radians(azimuth_deg)
    point = [[10 * np.cos(phi), 10 * np.sin(phi), 1.0]]
    image = project_heights(Scan(np.array(point)), RingGrid(), Reducer.MEAN, 1.0)
    assert np.argwhere(image.heights_m).tolist() == [[2, column]]


def test_what_lies_below_the_ground_is_on_it():
    points = np.array([[10.0, 0.0, -5.0], [10.0, 0.0, 1.0]])
    mean = project_heights(Scan(points), RingGrid(), Reducer.MEAN, 2.0)
    assert mean.heights_m[2, 0] == np.float32(1.5)


@pytest.mark.parametrize(
    ("points", "said"),
    [
        ([[100.0, 0.0, 0.0]], "within 80 m"),
        ([[10.0, 0.0, -3.0]], "above the ground"),
        ([[1e38, 1e38, 0.0]], "within 80 m"),
    ],
)
def test_a_scan_without_a_height_is_refused(points, said):
    with pytest.raises(InvalidScan, match=said):
        project_heights(Scan(np.array(points)), RingGrid(), Reducer.MEAN, 1.73)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"ring_m": 0.0}, "ring_m"),
        ({"ring_m": float("nan")}, "ring_m"),
        ({"rings": 0}, "rings"),
        ({"rings": 2.5}, "rings"),
        ({"rings": 10**6}, "cells"),
        ({"azimuth_step_deg": 7.0}, "does not divide 180"),
    ],
)
def test_rings_that_cannot_be_are_refused(changes, said):
    with pytest.raises(InvalidParameters, match=said):
        RingGrid(**changes)


def test_equal_rings_are_one_grid_however_they_are_written():
    assert RingGrid(4, 20, 1) == RingGrid()
    assert RingGrid(4, 20, 1).as_attributes() == {
        "ring_m": 4.0,
        "rings": 20,
        "azimuth_step_deg": 1.0,
    }


@pytest.mark.parametrize("fill", [0.0, -1.0, np.nan, np.inf])
def test_an_image_that_cannot_be_is_refused(fill):
    with pytest.raises(InvalidImage, match="heights_m"):
        HeightImage(np.full((20, 360), fill, np.float32), RingGrid())
    with pytest.raises(InvalidImage, match="shape"):
        HeightImage(np.ones((20, 361), np.float32), RingGrid())


def test_each_kind_of_image_has_its_own_reducers():
    scan = Scan(sample_points(0))
    with pytest.raises(InvalidParameters, match="highest"):
        project_scan(scan, AngularGrid(), Reducer.HIGHEST)
    for reducer in set(RANGE_REDUCERS) - {Reducer.MEAN}:
        with pytest.raises(InvalidParameters, match=reducer):
            project_heights(scan, RingGrid(), reducer, 1.73)
        with pytest.raises(InvalidParameters, match="a height image wants mean, highest"):
            Imager(RingGrid(), reducer)
    assert Imager(RingGrid(), Reducer.MEAN).kind == ImageKind.HEIGHT


# From beside


def test_a_scan_is_rendered_from_each_place():
    scan = Scan(sample_points(1))
    imager = Imager(RingGrid(), Reducer.MEAN, 1.73, (-2.0, 0.0, 2.0))
    rendered = imager.render(scan)
    assert rendered.shape == imager.shape == (3, 20, 360)
    np.testing.assert_array_equal(rendered[1], imager.image(scan).cells)
    there = Scan.from_returns(scan.points_m - np.array([0.0, 2.0, 0.0], np.float32))
    np.testing.assert_allclose(rendered[2], imager.image(there).cells, atol=1e-5)


def test_a_query_may_be_of_a_sensor_mounted_otherwise():
    scan = Scan(sample_points(1))
    lower = Scan(scan.points_m - np.array([0.0, 0.0, 0.5], np.float32))
    imager = Imager(RingGrid(), Reducer.HIGHEST, 1.73)
    np.testing.assert_allclose(imager.image(lower, 2.23).cells, imager.image(scan).cells, atol=1e-5)
    ranges = Imager(AngularGrid(), Reducer.MEAN, 1.73)
    np.testing.assert_array_equal(ranges.image(scan, 9.0).cells, ranges.image(scan).cells)


@pytest.mark.parametrize(
    "offsets", [(), (0.0, 0.0), (1.0, -1.0), (float("nan"),), (51.0,), tuple(range(-40, 41))]
)
def test_renderings_that_cannot_be_are_refused(offsets):
    with pytest.raises(InvalidParameters, match="lateral_renderings_m"):
        Imager(RingGrid(), Reducer.MEAN, 1.73, offsets)


def test_there_is_one_zero():
    imager = Imager(RingGrid(), Reducer.MEAN, 1.73, (-0.0,))
    assert str(imager.lateral_renderings_m) == "(0.0,)"
