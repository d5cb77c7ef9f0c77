"""The simulated city and its cars."""

import numpy as np
import pytest

from core.errors import InvalidParameters
from core.simulation.city import City
from core.simulation.world import Boxes, Cylinders, Traffic, World


def test_one_seed_is_one_city():
    assert City(4, 4).street_x_m == City(4, 4).street_x_m
    one, same = City(4, 4).whole(), City(4, 4).whole()
    for part in ("buildings", "poles", "parked", "moving"):
        np.testing.assert_array_equal(getattr(one, part).rows, getattr(same, part).rows)


def test_another_seed_is_another_city():
    assert City(4, 4).street_x_m != City(5, 5).street_x_m


def test_other_traffic_leaves_streets_houses_and_trees_where_they_were():
    assert City(4, 4).street_y_m == City(4, 5).street_y_m
    one, other = City(4, 4).whole(), City(4, 5).whole()
    np.testing.assert_array_equal(one.buildings.rows, other.buildings.rows)
    np.testing.assert_array_equal(one.poles.rows, other.poles.rows)
    assert not np.array_equal(one.parked.rows, other.parked.rows)
    assert not np.array_equal(one.moving.rows, other.moving.rows)


def test_moving_cars_move_at_their_speed_and_parked_ones_do_not():
    world = City(2, 2).whole()
    built = len(world.buildings) + len(world.parked)
    now, later = (world.at(time_s).boxes.rows for time_s in (3.0, 3.1))
    np.testing.assert_array_equal(now[:built], later[:built])
    moved_m = np.hypot(*(later - now)[built:, :2].T)
    on_lane = moved_m < 5.0  # the others have just entered their lanes again
    assert on_lane.mean() > 0.9
    np.testing.assert_allclose(moved_m[on_lane], 0.1 * world.moving.rows[on_lane, 5])


def test_moving_cars_give_way():
    world = World(moving=Traffic([[0.0, 0.0, 0.0, 100.0, 10.0, 10.0, 4.5, 1.8, 1.5]]))
    assert len(world.at(0.0, around_m=(13.0, 0.0), give_way_m=1.0).boxes) == 0
    assert len(world.at(1.0, around_m=(13.0, 0.0), give_way_m=1.0).boxes) == 1


def test_no_house_is_in_a_street_that_is_driven():
    for seed in range(5):
        city = City(seed, seed)
        world, xs, ys = city.whole(), city.street_x_m, city.street_y_m
        for x in xs[1:-1]:
            for y in np.arange(ys[1], ys[-2], 2.0):
                assert world.buildings.distance_m(x, float(y)).min() > 5.0


def test_the_distance_to_a_box_is_to_its_nearest_side_or_corner():
    rotated = Boxes([[10.0, 0.0, 90.0, 8.0, 2.0, 0.0, 3.0]])
    np.testing.assert_allclose(rotated.distance_m(0.0, 0.0), [9.0])
    np.testing.assert_allclose(rotated.distance_m(6.0, 8.0), [5.0])
    np.testing.assert_allclose(rotated.distance_m(10.5, 3.5), [0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("make", "rows"),
    [
        (Boxes, [[0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0]]),
        (Boxes, [[0.0, 0.0, 0.0, 1.0, 1.0, 2.0, 1.0]]),
        (Boxes, [[0.0, np.nan, 0.0, 1.0, 1.0, 0.0, 1.0]]),
        (Cylinders, [[0.0, 0.0, -1.0, 0.0, 1.0]]),
        (Cylinders, [[0.0, 0.0, 1.0, -1.0, 1.0]]),
        (Traffic, [[0.0, 0.0, 0.0, 0.0, 0.0, 5.0, 4.5, 1.8, 1.5]]),
    ],
)
def test_an_invalid_solid_is_rejected(make, rows):
    with pytest.raises(InvalidParameters, match="a solid"):
        make(rows)


def test_a_negative_seed_or_an_empty_city_is_rejected():
    with pytest.raises(InvalidParameters, match="seed is -1"):
        City(-1, 1)
    with pytest.raises(InvalidParameters, match="seed is -1"):
        City(1, -1)
    with pytest.raises(InvalidParameters, match="blocks"):
        City(1, 1, (0, 1))
