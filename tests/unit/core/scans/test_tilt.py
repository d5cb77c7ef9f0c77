"""The tilt of a vehicle against gravity."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.errors import InvalidParameters
from core.scans.mounting import Mounting
from core.scans.pose import Pose
from core.scans.scan import Scan
from core.scans.tilt import Tilt
from tests.support.samples import sample_points

angles_deg = st.floats(-45, 45)


def test_what_is_ahead_of_a_vehicle_whose_front_is_down_is_below():
    level = Tilt(0.0, 30.0).level(Scan.from_returns([[10.0, 0.0, 0.0]]))
    np.testing.assert_allclose(level.points_m, [[8.66025, 0.0, -5.0]], atol=1e-5)


def test_what_is_left_of_a_vehicle_whose_right_side_is_down_is_above():
    level = Tilt(30.0, 0.0).level(Scan.from_returns([[0.0, 10.0, 0.0]]))
    np.testing.assert_allclose(level.points_m, [[0.0, 8.66025, 5.0]], atol=1e-5)


@given(angles_deg, angles_deg)
def test_angles_are_those_of_a_mounting(roll_deg, pitch_deg):
    scan = Scan(sample_points(3))
    mounting = Mounting(0.0, 0.0, 2.0, roll_deg, pitch_deg)
    level = Tilt(roll_deg, pitch_deg).level(scan)
    np.testing.assert_allclose(level.points_m, mounting.mount(scan, 2.0).points_m, atol=1e-4)


def test_a_levelled_scan_is_level_and_has_the_same_time_and_pose():
    scan = Scan(sample_points(3), timestamp_s=4.0, pose=Pose(1.0, 2.0, 3.0))
    level = Tilt(1.0, 2.0).level(scan)
    assert level.is_level
    assert not scan.is_level
    assert (level.timestamp_s, level.pose) == (4.0, scan.pose)


@pytest.mark.parametrize("angle_deg", [math.nan, math.inf, -math.inf, 45.1, -90.0])
def test_angles_beyond_45_degrees_are_rejected(angle_deg):
    with pytest.raises(InvalidParameters, match=r"roll_deg is .*, wanted -45 to 45"):
        Tilt(angle_deg, 0.0)
    with pytest.raises(InvalidParameters, match=r"pitch_deg is .*, wanted -45 to 45"):
        Tilt(0.0, angle_deg)


def test_one_angle_alone_is_rejected():
    assert Tilt.of(None, None) is None
    assert Tilt.of(1.0, 0.0) == Tilt(1.0, 0.0)
    with pytest.raises(InvalidParameters, match="pitch_deg is None, wanted both or neither"):
        Tilt.of(1.0, None)
    with pytest.raises(InvalidParameters, match="roll_deg is None and"):
        Tilt.of(None, 1.0)


def test_the_dropped_returns_of_a_scan_are_those_of_the_levelled_one_too():
    scan = Scan.from_returns(np.concatenate([np.zeros((5, 3)), np.ones((3, 3))]))
    levelled = Tilt(roll_deg=1.0, pitch_deg=2.0).level(scan)
    assert (len(levelled), levelled.dropped_returns) == (3, 5)
