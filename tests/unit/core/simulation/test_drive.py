"""Drives through the simulated city, and the line they follow."""

import numpy as np
import pytest

from core import simulation
from core.arrays import FloatArray
from core.errors import InvalidParameters
from core.scans.drive import Drive
from core.scans.pose import heading_deg
from core.simulation import SimulatedDrive
from core.simulation.route import Route


@pytest.fixture(scope="module")
def drive() -> SimulatedDrive:
    return SimulatedDrive(seed=1)


def steps_m(drive: SimulatedDrive) -> FloatArray:
    return np.asarray(np.linalg.norm(np.diff(drive.poses[:, :2], axis=0), axis=1))


def heading_change_deg(drive: SimulatedDrive) -> FloatArray:
    return np.asarray((np.diff(heading_deg(drive.poses)) + 180.0) % 360.0 - 180.0)


def test_a_simulated_drive_is_a_drive(drive):
    as_drive: Drive = drive
    assert len(as_drive) == 300
    assert as_drive.poses.shape == (300, 7)
    np.testing.assert_allclose(np.diff(as_drive.timestamp_s), 0.1)
    scan = as_drive.scan(7)
    assert scan.pose is not None
    assert scan.pose.as_tuple() == tuple(as_drive.poses[7])
    assert scan.timestamp_s == as_drive.timestamp_s[7]


def test_one_seed_is_one_drive_to_the_bit(drive):
    again = SimulatedDrive(seed=1)
    np.testing.assert_array_equal(drive.poses, again.poses)
    for index in (0, 150, 299):
        np.testing.assert_array_equal(drive.scan(index).points_m, again.scan(index).points_m)


def test_another_seed_is_another_drive(drive):
    other = SimulatedDrive(seed=2)
    assert not np.array_equal(drive.poses, other.poses)
    assert not np.array_equal(drive.scan(0).points_m, other.scan(0).points_m)


def test_a_scan_does_not_depend_on_scans_read_before(drive):
    there = [drive.scan(index).points_m for index in (3, 4, 5)]
    back = [drive.scan(index).points_m for index in (5, 4, 3)]
    for one, other in zip(there, reversed(back), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_scan_has_about_60_000_returns(drive):
    returns = [len(drive.scan(index)) for index in range(0, len(drive), 15)]
    assert 50_000 < np.mean(returns) < 70_000


@pytest.mark.parametrize("seed", range(8))
def test_a_drive_turns_stops_and_closes_a_loop(seed):
    drive = SimulatedDrive(seed=seed)
    assert (steps_m(drive) == 0.0).sum() >= 8
    assert np.abs(heading_change_deg(drive)).sum() > 4 * 85.0
    assert drive.along_m[-1] > drive.route.length_m
    away_m = np.linalg.norm(drive.poses[:, :2] - drive.poses[0, :2], axis=1)
    assert away_m.max() > 50.0
    assert away_m[200:].min() < 1.5


@pytest.mark.parametrize("scans", [600, 1500])
def test_a_longer_drive_closes_a_longer_loop_that_turns_both_ways(scans):
    drive = SimulatedDrive(seed=1, scans=scans)
    assert drive.along_m[-1] > drive.route.length_m
    assert drive.route.length_m > scans * 0.7
    if scans == 1500:
        assert heading_change_deg(drive).min() < -1.0
        assert heading_change_deg(drive).max() > 1.0


def test_without_stops_the_vehicle_is_never_stationary():
    assert steps_m(SimulatedDrive(seed=1, stops=False)).min() > 0.5


def test_the_vehicle_advances_a_tenth_of_its_speed_a_scan_and_slows_in_turns():
    drive = SimulatedDrive(seed=1, stops=False, speed_m_s=12.0)
    step_m = np.diff(drive.along_m)
    assert step_m.max() == pytest.approx(1.2)
    straight = np.abs(heading_change_deg(drive)) < 1e-9
    np.testing.assert_allclose(step_m[straight], 1.2)
    assert step_m[~straight].min() < 1.0


@pytest.mark.parametrize("offset_m", [3.0, -2.25])
@pytest.mark.parametrize("reverse", [False, True])
def test_a_lateral_offset_lies_exactly_to_the_left_of_the_heading(offset_m, reverse):
    line = SimulatedDrive(seed=1, reverse=reverse)
    beside = SimulatedDrive(seed=1, reverse=reverse, lateral_offset_m=offset_m)
    heading = np.radians(heading_deg(line.poses))
    left = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
    np.testing.assert_allclose(beside.poses[:, :2] - line.poses[:, :2], offset_m * left, atol=1e-9)
    np.testing.assert_array_equal(beside.poses[:, 2:], line.poses[:, 2:])


def test_a_reversed_drive_has_the_same_places_at_180_degrees_of_relative_yaw(drive):
    reverse = SimulatedDrive(seed=1, reverse=True)
    np.testing.assert_allclose(reverse.poses[::-1, :3], drive.poses[:, :3], atol=1e-9)
    difference_deg = np.abs(heading_deg(reverse.poses)[::-1] - heading_deg(drive.poses))
    np.testing.assert_allclose(difference_deg, 180.0, atol=1e-9)


def test_other_traffic_is_the_same_line_with_other_cars(drive):
    other = SimulatedDrive(seed=1, traffic_seed=9)
    np.testing.assert_array_equal(drive.poses, other.poses)
    np.testing.assert_array_equal(drive.world.buildings.rows, other.world.buildings.rows)
    assert not np.array_equal(drive.world.parked.rows, other.world.parked.rows)


def test_other_noise_is_the_same_world_seen_again(drive):
    other = SimulatedDrive(seed=1, noise_seed=9)
    np.testing.assert_array_equal(drive.world.parked.rows, other.world.parked.rows)
    assert not np.array_equal(drive.scan(0).points_m, other.scan(0).points_m)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("offset_m", [-3.0, 0.0, 3.0])
def test_a_vehicle_up_to_3_m_aside_drives_through_no_solid(seed, offset_m):
    drive = SimulatedDrive(seed=seed, lateral_offset_m=offset_m)
    half_vehicle_m = 0.9
    for x, y in drive.poses[::3, :2].tolist():
        assert drive.world.parked.distance_m(x, y).min() > half_vehicle_m
        assert drive.world.buildings.distance_m(x, y).min() > half_vehicle_m
        poles = drive.world.poles.rows
        trunks = poles[poles[:, 3] == 0.0]
        assert (np.hypot(trunks[:, 0] - x, trunks[:, 1] - y) - trunks[:, 2]).min() > half_vehicle_m


def test_a_scan_that_is_not_there_is_an_index_error(drive):
    for index in (-1, 300):
        with pytest.raises(IndexError, match="drive of 300"):
            drive.scan(index)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("scans", 0),
        ("speed_m_s", 0.0),
        ("lateral_offset_m", 20.0),
        ("sensor_height_m", 0.0),
        ("noise_seed", -1),
        ("loop_m", 0.0),
    ],
)
def test_an_invalid_drive_is_rejected_by_name(name, value):
    with pytest.raises(InvalidParameters, match=name):
        SimulatedDrive(**{name: value})


def test_a_route_is_continuous_in_place_and_heading():
    corners = [(0, 0), (90, 0), (90, 70), (40, 70), (40, 120), (0, 120)]
    route = Route.around(corners, turn_radius_m=10.0)
    along_m = np.linspace(0.0, 2.0 * route.length_m, 20_001)
    x_m, y_m, heading = route.at(along_m)
    step_m = np.diff(along_m)[0]
    moved_m = np.hypot(np.diff(x_m), np.diff(y_m))
    np.testing.assert_allclose(moved_m, step_m, rtol=1e-3)
    change_deg = (np.diff(heading) + 180.0) % 360.0 - 180.0
    assert np.abs(change_deg).max() <= np.degrees(step_m / 10.0) + 1e-6
    direction = np.degrees(np.arctan2(np.diff(y_m), np.diff(x_m)))
    off_deg = (direction - heading[:-1] + 180.0) % 360.0 - 180.0
    assert np.abs(off_deg).max() < 0.2


def test_a_route_whose_arcs_do_not_fit_is_rejected():
    with pytest.raises(InvalidParameters, match="do not fit"):
        Route.around([(0, 0), (15, 0), (15, 80), (0, 80)], turn_radius_m=10.0)
    with pytest.raises(InvalidParameters, match="three corners"):
        Route.around([(0, 0), (15, 0)], turn_radius_m=1.0)


def test_all_holds_what_it_names():
    assert all(hasattr(simulation, name) for name in simulation.__all__)
