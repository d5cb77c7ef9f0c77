"""Stationary vehicles, and the surrogate of motion (paper, sec. 3)."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.evaluation.motion import is_standing, motion_surrogate
from tests.support.samples import straight_poses


def at(x_m):
    rows = straight_poses(len(x_m))
    rows[:, 0] = x_m
    return rows


def test_a_vehicle_that_moved_less_than_5_cm_in_a_tenth_of_a_second_is_stationary():
    poses = at([0.0, 0.04, 0.10, 0.14])
    assert is_standing(poses, np.arange(4) / 10).tolist() == [True, True, False, True]


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_vehicle_that_turns_on_the_spot_is_not_stationary(axis):
    poses = at([0.0, 0.0, 0.0, 0.04])
    turned_deg = [[0.0], [4.0], [6.0], [7.8]]  # in a tenth of a second 5 cm, or 2.9 degrees
    poses[:, 3:] = Rotation.from_euler(axis, turned_deg, degrees=True).as_quat()
    assert is_standing(poses, np.arange(4) / 10).tolist() == [False, False, True, False]


def test_a_stationary_sensor_that_looks_up_is_stationary():
    poses = at([0.0, 0.0])
    poses[:, 3:] = Rotation.from_euler("yx", [[-90.0, 0.0], [-90.0, 0.1]], degrees=True).as_quat()
    assert is_standing(poses, np.arange(2) / 10).all()


def test_the_first_scan_is_stationary_if_the_second_has_not_moved():
    assert is_standing(at([0.0, 1.0, 1.0]), np.arange(3) / 10).tolist() == [False, False, True]
    assert is_standing(at([0.0, 0.0, 1.0]), np.arange(3) / 10).tolist() == [True, True, False]
    assert is_standing(at([0.0]), np.zeros(1)).tolist() == [False]
    assert is_standing(at([]), np.zeros(0)).tolist() == []


@pytest.mark.parametrize(("period_s", "stationary"), [(0.1, False), (0.5, True), (0.05, False)])
def test_the_rule_scales_with_the_time_between_scans(period_s, stationary):
    assert is_standing(at([0.0, 0.2]), np.array([0.0, period_s]))[1] == stationary


@pytest.mark.parametrize("times", [[0.0, np.nan], [np.nan, np.nan], [5.0, 5.0], [5.0, 1.0]])
def test_an_unknown_or_impossible_time_counts_as_a_tenth_of_a_second(times):
    assert is_standing(at([0.0, 0.04]), np.array(times))[1]
    assert not is_standing(at([0.0, 0.06]), np.array(times))[1]


def test_a_vehicle_of_unknown_pose_counts_as_moving():
    poses = at([0.0, 0.0, 0.0, 0.0])
    poses[1] = np.nan
    assert is_standing(poses, np.arange(4) / 10).tolist() == [False, False, False, True]


def test_the_surrogate_is_the_norm_of_the_change_in_six_numbers():
    poses = at([0.0, 3.0, 3.0])
    poses[1:, 3:] = Rotation.from_euler("z", 4.0, degrees=False).as_quat()
    angle_change = 2 * np.pi - 4.0
    expected = np.hypot(3.0, angle_change)
    np.testing.assert_allclose(motion_surrogate(poses), [expected, expected, 0.0], atol=1e-12)


def test_the_surrogate_of_a_sensor_that_looks_straight_up_or_down_raises_no_warning():
    poses = at([0.0, 3.0])
    poses[:, 3:] = Rotation.from_euler("y", [[-90.0], [90.0]], degrees=True).as_quat()
    expected = np.hypot(3.0, np.pi)
    np.testing.assert_allclose(motion_surrogate(poses), [expected, expected], atol=1e-7)


@pytest.mark.parametrize("axis", ["x", "z"])
def test_the_surrogate_takes_the_short_way_round_180_degrees(axis):
    poses = at([0.0, 0.0])
    poses[0, 3:] = Rotation.from_euler(axis, 179.0, degrees=True).as_quat()
    poses[1, 3:] = Rotation.from_euler(axis, -179.0, degrees=True).as_quat()
    np.testing.assert_allclose(motion_surrogate(poses), np.radians(2.0))


def test_the_surrogate_is_unknown_where_a_pose_is():
    poses = at([0.0, 1.0, 2.0, 3.0])
    poses[1] = np.nan
    np.testing.assert_array_equal(motion_surrogate(poses), [np.nan, np.nan, np.nan, 1.0])
    np.testing.assert_array_equal(motion_surrogate(at([0.0])), [np.nan])
    assert motion_surrogate(at([])).shape == (0,)
    assert json.dumps(motion_surrogate(at([0.0, 1.0])).tolist()) == "[1.0, 1.0]"
