"""Conditions: yaw, lateral offset and noise (paper, sec. 3)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from core.errors import InvalidParameters
from core.evaluation.condition import Condition, conditions
from core.scans.scan import Scan
from tests.support.samples import sample_points


def applied(condition, points, seed=0):
    scan = Scan(np.asarray(points, dtype=np.float32))
    return condition.apply(scan, np.random.default_rng(seed)).points_m


def test_no_disturbance_is_the_scan_itself():
    scan = Scan(sample_points(0))
    assert Condition().apply(scan, np.random.default_rng(0)) is scan


def test_a_vehicle_farther_left_sees_its_returns_farther_right():
    moved = applied(Condition(lateral_m=2.0), [[10.0, 0.0, 1.0]])
    np.testing.assert_allclose(moved, [[10.0, -2.0, 1.0]])


def test_yaw_to_the_left_rotates_the_returns_to_the_right():
    rotated = applied(Condition(yaw_deg=90.0), [[10.0, 0.0, 1.0]])
    np.testing.assert_allclose(rotated, [[0.0, -10.0, 1.0]], atol=1e-5)


def test_the_lateral_offset_comes_before_the_yaw():
    # p' = Rz(-30) (p - (0, 2, 0)), p = (10, 5, 1): by hand.
    c, s = np.sqrt(3.0) / 2.0, 0.5
    expected = [[c * 10.0 + s * 3.0, -s * 10.0 + c * 3.0, 1.0]]
    found = applied(Condition(yaw_deg=30.0, lateral_m=2.0), [[10.0, 5.0, 1.0]])
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@given(st.floats(-180, 180), st.floats(-5, 5))
def test_the_returns_stay_where_they_are_in_the_world(yaw_deg, lateral_m):
    condition = Condition(yaw_deg, lateral_m)
    points = sample_points(3)
    recorded = Rotation.from_euler("z", 40.0, degrees=True)
    pose = np.concatenate([[100.0, 50.0, 2.0], recorded.as_quat()])
    query_rotation = Rotation.from_euler("z", 40.0 + yaw_deg, degrees=True)
    in_world = recorded.apply(points) + pose[:3]
    again = query_rotation.apply(applied(condition, points)) + condition.pose(pose)[:3]
    np.testing.assert_allclose(again, in_world, atol=1e-4)


def test_noise_has_the_given_spread_and_is_reproducible():
    points = np.tile([[10.0, 20.0, 1.0]], (20_000, 1))
    noisy = applied(Condition(noise_m=0.5), points, seed=7)
    np.testing.assert_array_equal(noisy, applied(Condition(noise_m=0.5), points, seed=7))
    assert not np.array_equal(noisy, applied(Condition(noise_m=0.5), points, seed=8))
    np.testing.assert_allclose((noisy - points).std(axis=0), 0.5, rtol=0.05)
    np.testing.assert_allclose((noisy - points).mean(axis=0), 0.0, atol=0.02)


def test_the_place_of_an_unknown_pose_is_unknown():
    assert np.isnan(Condition(lateral_m=2.0).pose(np.full(7, np.nan))).all()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"yaw_deg": np.nan}, "^yaw_deg is nan, wanted a finite number$"),
        ({"lateral_m": np.inf}, "^lateral_m is inf, wanted a finite number$"),
        ({"noise_m": np.nan}, "noise_m is nan"),
        ({"noise_m": -0.1}, "noise_m is -0.1"),
        ({"yaw_deg": 1e308}, r"yaw_deg is 1e\+308, wanted -360 to 360"),
        ({"noise_m": 1e300}, r"noise_m is 1e\+300, wanted at most 1000"),
    ],
)
def test_an_invalid_condition_is_rejected(wrong, message):
    with pytest.raises(InvalidParameters, match=message):
        Condition(**wrong)


def test_conditions_are_the_product_of_their_lists():
    found = conditions([0.0, 90.0], [0.0], [0.0, 0.5])
    assert found == (
        Condition(),
        Condition(noise_m=0.5),
        Condition(yaw_deg=90.0),
        Condition(yaw_deg=90.0, noise_m=0.5),
    )
    assert conditions([], [0.0], [0.0]) == ()


def test_disturbances_come_after_the_displacement_and_before_the_noise():
    scan = Scan(np.array([[10.0, 0.0, 0.0], [0.0, 10.0, 0.0]]))
    condition = Condition(yaw_deg=90.0, disturb="fov:90+height:1")
    disturbed = condition.apply(scan, np.random.default_rng(0))
    np.testing.assert_allclose(disturbed.points_m, [[10.0, 0.0, -1.0]], atol=1e-6)


@pytest.mark.parametrize("disturb", ["hidden:60,fov:90", "fog:1", "hidden"])
def test_a_condition_has_one_combination_of_disturbances(disturb):
    with pytest.raises(InvalidParameters, match="disturb"):
        Condition(disturb=disturb)


def test_conditions_are_the_product_with_disturbances():
    made = conditions((0.0, 90.0), (0.0,), (0.0,), ["", "hidden:60"])
    assert [(c.yaw_deg, c.disturb) for c in made] == [
        (0.0, ""), (0.0, "hidden:60"), (90.0, ""), (90.0, "hidden:60"),
    ]  # fmt: skip
