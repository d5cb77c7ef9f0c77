"""The ground below a sensor, and scans rotated level above it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from core.errors import InvalidParameters
from core.evaluation.disturbances import KITTI_RECORDING, parse_disturbance
from core.projection.ground import ground_plane
from core.projection.levelling import level
from core.scans.pose import Pose
from core.scans.scan import Scan
from core.scans.tilt import Tilt
from core.simulation.drive import SimulatedDrive

HEIGHT_M = 1.73


def street(seed=0, height_m=HEIGHT_M):
    """Return a level street in float64: ground, walls on both sides, what is on the ground."""
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(-30, 30, (2500, 2)), np.full(2500, -height_m)])
    ground = ground[np.abs(ground[:, 1]) < 12]
    wall = np.column_stack([rng.uniform(-30, 30, 800), rng.choice([-12, 12], 800), np.zeros(800)])
    wall[:, 2] = rng.uniform(-height_m, 6, 800)
    bush = np.column_stack([rng.uniform(-20, 20, (150, 2)), rng.uniform(-height_m, 1, 150)])
    return np.concatenate([ground, wall, bush])


def tilt_deg(plane, up):
    return math.degrees(math.acos(min(1.0, float(np.dot(plane.normal, up)))))


def seen(points_m):
    return Scan(points_m.astype(np.float32))


tilts_deg = st.floats(-6, 6)


@settings(deadline=None, max_examples=40)
@given(tilts_deg, tilts_deg, st.floats(-180, 180), st.floats(1.3, 2.6), st.integers(0, 99))
def test_the_ground_of_a_tilted_street_is_found_at_its_depth(roll, pitch, yaw, depth_m, seed):
    turn = Rotation.from_euler("zyx", [yaw, pitch, roll], degrees=True)
    plane = ground_plane(seen(turn.apply(street(seed, depth_m))).points_m, HEIGHT_M)
    assert plane is not None
    assert tilt_deg(plane, turn.apply([0, 0, 1])) < 0.3
    assert abs(plane.depth_m - depth_m) < 0.03


@settings(deadline=None, max_examples=40)
@given(tilts_deg, tilts_deg, st.floats(1.3, 2.6))
def test_a_levelled_scan_is_that_of_a_level_sensor_without_a_turn_about_the_vertical(
    about_x, about_y, depth_m
):
    smallest = Rotation.from_rotvec(np.radians([about_x, about_y, 0.0]))
    levelled = level(seen(smallest.apply(street(0, depth_m))), HEIGHT_M)
    expected = street(0, depth_m) + np.array([0.0, 0.0, depth_m - HEIGHT_M])
    assert np.abs(levelled.points_m - expected).max() < 0.2  # metres, 40 m away


@settings(deadline=None, max_examples=20)
@given(tilts_deg, tilts_deg, st.integers(0, 2**32 - 1))
def test_the_order_of_the_returns_does_not_matter(roll, pitch, seed):
    points_m = Rotation.from_euler("yx", [pitch, roll], degrees=True).apply(street())
    points_m = np.concatenate([points_m, points_m[:50]])  # some are there twice
    order = np.random.default_rng(seed).permutation(len(points_m))
    levelled = level(seen(points_m), HEIGHT_M).points_m
    assert level(seen(points_m[order]), HEIGHT_M).points_m.tobytes() == levelled[order].tobytes()


@settings(deadline=None, max_examples=20)
@given(tilts_deg, tilts_deg)
def test_what_is_level_stays_as_it_is(roll, pitch):
    turn = Rotation.from_euler("yx", [pitch, roll], degrees=True)
    once = level(seen(turn.apply(street())), HEIGHT_M)
    moved_m = level(once, HEIGHT_M).points_m - once.points_m
    assert np.abs(moved_m[:, :2]).max() == 0.0, "it is not rotated again"
    assert np.abs(moved_m[:, 2]).max() < 0.01
    assert once.is_level


def without_ground(kind):
    rng = np.random.default_rng(5)
    points_m = street()
    match kind:
        case "no returns":
            return points_m[:0]
        case "walls only":
            return points_m[points_m[:, 2] > -0.6]
        case "ground far below":
            return points_m - [0.0, 0.0, 8.0]
        case "ground above":
            return -points_m
        case "a strip of ground":
            return np.column_stack(
                [rng.uniform(3, 24, 900), rng.uniform(-1, 1, 900), -np.ones(900)]
            )
        case "a steep slope":
            return Rotation.from_euler("y", 16, degrees=True).apply(points_m)
        case "a few returns":
            return points_m[::250]
        case "what is beside the vehicle":
            return points_m[np.abs(points_m[:, :2]).max(axis=1) < 2]
    return np.column_stack([rng.uniform(-24, 24, (900, 2)), rng.uniform(-2.5, 3, 900)])


@pytest.mark.parametrize(
    "kind",
    [
        "no returns",
        "walls only",
        "ground far below",
        "ground above",
        "a strip of ground",
        "a steep slope",
        "a few returns",
        "what is beside the vehicle",
        "returns anywhere",
    ],
)
def test_a_scan_without_enough_ground_is_returned_as_it_is(kind):
    scan = seen(without_ground(kind))
    assert ground_plane(scan.points_m, HEIGHT_M) is None
    assert level(scan, HEIGHT_M) is scan


def beside_a_bank(seed, half_deg=180.0, rough_m=0.0):
    """Return a street with a bank to the right that rises by 15 degrees."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-24, 24, (4000, 2))
    rise_m = np.maximum(0.0, -2.0 - xy[:, 1]) * 0.27
    z = -0.95 + rise_m + rng.normal(0.0, np.where(rise_m > 0.0, rough_m, 0.02))
    points_m = np.column_stack([xy, z])
    return points_m[np.degrees(np.abs(np.arctan2(xy[:, 0], -xy[:, 1]))) < half_deg]


@pytest.mark.parametrize("seed", range(5))
def test_a_bank_beside_the_street_does_not_tilt_the_ground(seed):
    plane = ground_plane(seen(beside_a_bank(seed, rough_m=0.05)).points_m, 0.95)
    assert plane is not None
    assert tilt_deg(plane, [0, 0, 1]) < 0.5
    assert abs(plane.depth_m - 0.95) < 0.1


@pytest.mark.parametrize("seed", range(5))
def test_a_rough_bank_alone_is_no_ground(seed):
    scan = seen(beside_a_bank(seed, half_deg=60.0, rough_m=0.15))
    assert level(scan, 0.95) is scan


@pytest.mark.parametrize(
    "text",
    ["pitch:3", "roll:5", "height:0.5", "roll:5+fov:180", "truck:2", "fov:70", "drop:0.95"],
)
def test_disturbed_scans_of_a_simulated_street_are_levelled(text):
    points_m = SimulatedDrive(seed=71, scans=40).scan(25).points_m.astype(np.float64)
    up, depth_m = np.array([[0.0, 0.0, 1.0]]), HEIGHT_M
    for number, part in enumerate(text.split("+")):
        disturbance, rng = parse_disturbance(part), np.random.default_rng(number)
        points_m = disturbance.apply(points_m, KITTI_RECORDING, rng)
        if disturbance.name in ("pitch", "roll"):
            up = disturbance.apply(up, KITTI_RECORDING, np.random.default_rng(number))
        if disturbance.name == "height":
            depth_m += float(disturbance.value)
    plane = ground_plane(seen(points_m).points_m, HEIGHT_M)
    assert plane is not None
    assert tilt_deg(plane, up[0]) < 0.5
    assert abs(plane.depth_m - depth_m) < 0.05


def test_what_else_a_scan_has_stays_and_dropped_returns_are_counted():
    points_m = street().astype(np.float32)
    points_m[:, 2] += np.float32(0.1) * points_m[:, 0]
    huge = np.full((1, 3), np.finfo(np.float32).max, np.float32)
    pose = Pose(1.0, 2.0, 3.0)
    scan = Scan(np.concatenate([points_m, huge]), 12.5, pose, dropped_returns=4)
    levelled = level(scan, HEIGHT_M)
    assert (levelled.timestamp_s, levelled.pose) == (12.5, pose)
    assert (len(levelled), levelled.dropped_returns) == (len(scan) - 1, 5)
    assert levelled.is_level
    assert level(replace(scan, is_level=True), HEIGHT_M).is_level


@pytest.mark.parametrize("height_m", [0.0, -1.0, math.nan])
def test_a_sensor_that_is_not_above_the_ground_is_refused(height_m):
    with pytest.raises(InvalidParameters, match="sensor_height_m"):
        level(seen(street()), height_m)


@settings(deadline=None, max_examples=20)
@given(tilts_deg, tilts_deg, st.floats(1.3, 2.6))
def test_what_gravity_levelled_is_moved_to_its_ground_and_not_rotated(slope_x, slope_y, depth_m):
    """A street that rises or falls: its plane is not level, and its ground is below the sensor."""
    slope = Rotation.from_euler("yx", [slope_x, slope_y], degrees=True)
    level_axes = replace(seen(slope.apply(street(0, depth_m))), is_level=True)
    levelled = level(level_axes, HEIGHT_M).points_m
    moved_m = levelled - level_axes.points_m
    assert np.abs(moved_m[:, :2]).max() == 0.0
    vertical_m = depth_m / slope.apply([0.0, 0.0, 1.0])[2]
    np.testing.assert_allclose(moved_m[:, 2], vertical_m - HEIGHT_M, atol=0.04)


def test_gravity_levels_where_no_ground_is_seen():
    walls = street()[street()[:, 2] > -1.0]
    tilt = Tilt(roll_deg=-4.0, pitch_deg=7.0)
    turn = Rotation.from_euler("xy", [-4.0, 7.0], degrees=True)
    tilted = seen(turn.inv().apply(walls))
    assert level(tilted, HEIGHT_M) is tilted
    np.testing.assert_allclose(level(tilt.level(tilted), HEIGHT_M).points_m, walls, atol=1e-4)
