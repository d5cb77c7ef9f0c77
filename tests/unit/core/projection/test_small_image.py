"""A height image in one byte a cell, and what it is from other places."""

import numpy as np
import pytest

from core.projection.small_image import DisplacedView, small_image

RINGS, RING_M, COLUMNS = 20, 4.0, 360
HERE = np.zeros(1)


def at(x_m, y_m, height_m=4.0):
    """The height image of a tower, 3 m wide."""
    cells = np.zeros((RINGS, COLUMNS), np.float32)
    centre = np.array([x_m, y_m])
    for x, y in centre + np.random.default_rng(0).uniform(-1.5, 1.5, size=(400, 2)):
        azimuth = round(np.degrees(np.arctan2(y, x))) % COLUMNS
        cells[int(np.hypot(x, y) / RING_M), azimuth] = height_m
    return cells


def test_a_byte_is_the_root_of_the_greatest_height_of_its_sector():
    cells = np.zeros((2, 360), np.float32)
    cells[0, :6] = 0.0, 0.25, 9.0, 4.0, 1.0, 0.0
    cells[1, 354:] = 1e6
    cells[:, 12:18] = -1.0  # hidden
    small = small_image(cells)
    assert small.dtype == np.uint8
    assert small.shape == (2, 60)
    assert (small[0, 0], small[1, 59]) == (192, 255)
    assert np.count_nonzero(small) == 2


@pytest.mark.parametrize("columns", [40, 60, 100, 400])
def test_images_of_any_grid_have_sixty_columns(columns):
    cells = np.tile(np.arange(columns, dtype=np.float32), (3, 1))
    small = small_image(cells)
    assert small.shape == (3, 60)
    assert (np.diff(small.astype(int), axis=1) >= 0).all()


def test_from_its_own_place_an_image_is_unchanged():
    small = np.random.default_rng(1).integers(0, 256, size=(2, RINGS, 60), dtype=np.uint8)
    view = DisplacedView.at(RINGS, RING_M, COLUMNS, HERE, HERE)
    np.testing.assert_allclose(view.of(small)[:, 0], small, atol=1e-3)


def test_views_from_several_places_are_those_from_each():
    small = np.random.default_rng(2).integers(0, 256, size=(3, RINGS, 60), dtype=np.uint8)
    places = np.array([[0.0, 0.0], [1.0, -2.0], [-40.0, 90.0]])
    each = [DisplacedView.at(RINGS, RING_M, COLUMNS, *place[:, None]) for place in places]
    at_once = DisplacedView.concatenate(each).of(small)
    np.testing.assert_array_equal(at_once, np.concatenate([view.of(small) for view in each], 1))
    together = DisplacedView.at(RINGS, RING_M, COLUMNS, *places.T).of(small)
    np.testing.assert_array_equal(at_once, together)


@pytest.mark.parametrize(("ahead_m", "left_m"), [(3.0, 0.0), (0.0, 3.0), (-2.0, -1.5)])
def test_from_elsewhere_towers_are_where_they_are_seen_from_there(ahead_m, left_m):
    view = DisplacedView.at(RINGS, RING_M, COLUMNS, np.array([ahead_m]), np.array([left_m]))
    towers = [(22.0, 3.0), (-14.0, 30.0), (5.0, -41.0), (-9.0, -12.0), (15.0, -6.0), (8.0, 17.0)]

    def image(ahead_m, left_m):
        cells = np.max([at(x_m - ahead_m, y_m - left_m) for x_m, y_m in towers], axis=0)
        return small_image(cells).astype(float)

    def like(one, other):
        return (one * other).sum() / np.sqrt((one**2).sum() * (other**2).sum())

    displaced, seen = view.of(image(0.0, 0.0)[None])[0, 0], image(ahead_m, left_m)
    assert like(displaced, seen) > 0.6
    assert like(displaced, seen) > like(image(0.0, 0.0), seen) + 0.1
