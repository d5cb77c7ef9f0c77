"""Splits, conditions and motion: the parts of an evaluation (paper, sec. 3)."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from core.errors import InvalidParameters
from core.evaluation.condition import Condition, conditions
from core.evaluation.motion import is_standing, motion_surrogate
from core.evaluation.split import Every, Interleaved, parse_split
from core.scans.scan import Scan
from tests.support.samples import sample_points, straight_poses

# Splits


@given(st.lists(st.integers(1, 60), min_size=1, max_size=6))
def test_80_to_20_holds_out_every_fifth_scan_of_each_segment(sizes):
    starts = np.cumsum([0, *sizes])
    j = np.concatenate([np.arange(size) for size in sizes])
    np.testing.assert_array_equal(Interleaved(0.2).held_out(starts), j % 5 == 2)


@given(st.floats(0.01, 0.99), st.integers(1, 500))
def test_a_fraction_of_every_segment_is_held_out_to_a_scan(fraction, scans):
    held_out = Interleaved(fraction).held_out(np.array([0, scans]))
    assert abs(held_out.sum() - fraction * scans) <= 1.0


def test_the_phases_of_80_to_20_hold_out_every_scan_once():
    starts = np.array([0, 13, 40])
    held_out = np.stack([Interleaved(0.2, phase).held_out(starts) for phase in range(5)])
    assert held_out.sum(axis=0).tolist() == [1] * 40
    first = [np.flatnonzero(Interleaved(0.2, p).held_out(starts))[0] for p in range(5)]
    assert first == [2, 1, 0, 4, 3]


@pytest.mark.parametrize("n", [2, 3, 7])
def test_every_nth_scan_of_the_drive_is_mapped_and_the_others_asked(n):
    held_out = Every(n).held_out(np.array([0, 10, 23]))
    np.testing.assert_array_equal(held_out, np.arange(23) % n != 0)


@pytest.mark.parametrize(
    ("text", "split"),
    [
        ("interleaved:0.2", Interleaved(0.2)),
        ("interleaved:.25", Interleaved(0.25)),
        ("interleaved:0.2:3", Interleaved(0.2, 3)),
        ("every:2", Every(2)),
        ("every:10", Every(10)),
    ],
)
def test_a_split_is_read_and_written_in_one_form(text, split):
    assert parse_split(text) == split
    assert parse_split(str(split)) == split


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the split is ''"),
        ("interleaved", "wanted interleaved:FRACTION"),
        ("interleaved:1.5", "the split is"),
        ("interleaved:-0.2", "the split is"),
        ("interleaved:nan", "the split is"),
        ("interleaved:0.2:-1", "the split is"),
        ("interleaved:0.2:", "the split is"),
        ("interleaved:0.2\n", "the split is"),
        ("interleaved:0.0", "held-out fraction is 0.0"),
        ("every:1", "n is 1"),
        ("every:0", "n is 0"),
        ("every:2.5", "the split is"),
        ("every:" + "9" * 30, "the split is"),
        ("interleaved:0.2:" + "9" * 30, "the split is"),
        ("random:0.2", "the split is"),
    ],
)
def test_a_split_that_cannot_be_is_refused(text, said):
    with pytest.raises(InvalidParameters, match=said):
        parse_split(text)


@pytest.mark.parametrize("fraction", [0.0, 1.0, -0.1, np.nan])
def test_a_fraction_that_leaves_nothing_is_refused(fraction):
    with pytest.raises(InvalidParameters, match="wanted 0 < f < 1"):
        Interleaved(fraction)
    with pytest.raises(InvalidParameters, match="the phase is -1"):
        Interleaved(0.2, -1)


# Conditions


def applied(condition, points, seed=0):
    scan = Scan(np.asarray(points, dtype=np.float32))
    return condition.apply(scan, np.random.default_rng(seed)).points_m


def test_no_disturbance_is_the_scan_itself():
    scan = Scan(sample_points(0))
    assert Condition().apply(scan, np.random.default_rng(0)) is scan


def test_a_vehicle_farther_left_sees_its_returns_farther_right():
    moved = applied(Condition(lateral_m=2.0), [[10.0, 0.0, 1.0]])
    np.testing.assert_allclose(moved, [[10.0, -2.0, 1.0]])


def test_a_vehicle_turned_left_sees_its_returns_turned_right():
    turned = applied(Condition(yaw_deg=90.0), [[10.0, 0.0, 1.0]])
    np.testing.assert_allclose(turned, [[0.0, -10.0, 1.0]], atol=1e-5)


def test_the_vehicle_is_displaced_first_and_turned_there():
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
    standing = Rotation.from_euler("z", 40.0 + yaw_deg, degrees=True)
    in_world = recorded.apply(points) + pose[:3]
    again = standing.apply(applied(condition, points)) + condition.pose(pose)[:3]
    np.testing.assert_allclose(again, in_world, atol=1e-4)


def test_noise_has_the_spread_asked_for_and_is_reproducible():
    points = np.tile([[10.0, 20.0, 1.0]], (20_000, 1))
    noisy = applied(Condition(noise_m=0.5), points, seed=7)
    np.testing.assert_array_equal(noisy, applied(Condition(noise_m=0.5), points, seed=7))
    assert not np.array_equal(noisy, applied(Condition(noise_m=0.5), points, seed=8))
    np.testing.assert_allclose((noisy - points).std(axis=0), 0.5, rtol=0.05)
    np.testing.assert_allclose((noisy - points).mean(axis=0), 0.0, atol=0.02)


def test_the_place_of_an_unknown_pose_is_unknown():
    assert np.isnan(Condition(lateral_m=2.0).pose(np.full(7, np.nan))).all()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"yaw_deg": np.nan}, "not finite"),
        ({"lateral_m": np.inf}, "not finite"),
        ({"noise_m": np.nan}, "not finite"),
        ({"noise_m": -0.1}, "noise_m is -0.1"),
    ],
)
def test_a_condition_that_cannot_be_is_refused(wrong, said):
    with pytest.raises(InvalidParameters, match=said):
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


# Motion


def at(x_m):
    rows = straight_poses(len(x_m))
    rows[:, 0] = x_m
    return rows


def test_a_vehicle_stands_that_moved_less_than_5_cm_in_a_tenth_of_a_second():
    poses = at([0.0, 0.04, 0.10, 0.14])
    assert is_standing(poses, np.arange(4) / 10).tolist() == [True, True, False, True]


def test_the_first_scan_stands_if_the_second_has_not_moved():
    assert is_standing(at([0.0, 1.0, 1.0]), np.arange(3) / 10).tolist() == [False, False, True]
    assert is_standing(at([0.0, 0.0, 1.0]), np.arange(3) / 10).tolist() == [True, True, False]
    assert is_standing(at([0.0]), np.zeros(1)).tolist() == [False]
    assert is_standing(at([]), np.zeros(0)).tolist() == []


@pytest.mark.parametrize(("period_s", "standing"), [(0.1, False), (0.5, True), (0.05, False)])
def test_the_rule_scales_with_the_time_between_scans(period_s, standing):
    assert is_standing(at([0.0, 0.2]), np.array([0.0, period_s]))[1] == standing


@pytest.mark.parametrize("times", [[0.0, np.nan], [np.nan, np.nan], [5.0, 5.0], [5.0, 1.0]])
def test_an_unknown_or_impossible_time_counts_as_a_tenth_of_a_second(times):
    assert is_standing(at([0.0, 0.04]), np.array(times))[1]
    assert not is_standing(at([0.0, 0.06]), np.array(times))[1]


def test_nothing_shows_that_a_vehicle_of_unknown_pose_stands():
    poses = at([0.0, 0.0, 0.0, 0.0])
    poses[1] = np.nan
    assert is_standing(poses, np.arange(4) / 10).tolist() == [False, False, False, True]


def test_the_surrogate_is_the_norm_of_the_change_in_six_numbers():
    poses = at([0.0, 3.0, 3.0])
    poses[1:, 3:] = Rotation.from_euler("z", 4.0, degrees=False).as_quat()
    turned = 2 * np.pi - 4.0
    expected = np.hypot(3.0, turned)
    np.testing.assert_allclose(motion_surrogate(poses), [expected, expected, 0.0], atol=1e-12)


@pytest.mark.parametrize("axis", ["x", "z"])
def test_the_surrogate_takes_the_short_way_round_half_a_turn(axis):
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
