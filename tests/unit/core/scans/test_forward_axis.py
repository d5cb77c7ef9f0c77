"""A drive moves along x of its frame, or along another axis."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.scans.forward_axis import ForwardAxis, find_other_forward_axis
from core.scans.mounting import Mounting
from core.simulation import SimulatedDrive

POSES = SimulatedDrive(seed=5, scans=80).poses


def of_sensor(yaw_deg, poses=POSES):
    """Return the poses of a sensor that is turned on the vehicle."""
    return Mounting(0.0, 0.0, 1.0, yaw_deg=yaw_deg).sensor_poses(poses)


@pytest.mark.parametrize(("axis", "yaw_deg"), [("+y", -90.0), ("-y", 90.0), ("-x", 180.0)])
def test_another_axis_forward_is_found_with_the_yaw_of_the_mounting_that_mends_it(axis, yaw_deg):
    sensor = of_sensor(yaw_deg)
    found = find_other_forward_axis(sensor)
    assert found == ForwardAxis(axis, 1.0)
    mended = Mounting(0.0, 0.0, 1.0, yaw_deg=found.yaw_deg).vehicle_poses(sensor)
    assert find_other_forward_axis(mended) is None


@pytest.mark.parametrize("yaw_deg", [0.0, 15.0, -30.0, 45.0, 60.0])
def test_a_sensor_that_looks_ahead_or_aslant_raises_no_alarm(yaw_deg):
    assert find_other_forward_axis(of_sensor(yaw_deg)) is None


def test_a_vehicle_that_reverses_for_a_part_of_its_drive_raises_no_alarm():
    back = POSES[::-1]
    assert find_other_forward_axis(np.concatenate([POSES[:20], back[-20:], back])) is None


def test_steps_of_decimetres_and_unknown_poses_change_nothing():
    fine = np.repeat(of_sensor(90.0), 2, axis=0)
    fine[1:-1:2, :3] = (fine[0:-2:2, :3] + fine[2::2, :3]) / 2
    fine[10:14] = np.nan
    found = find_other_forward_axis(fine)
    assert found is not None
    assert found.axis == "-y"


def test_where_a_vehicle_stands_or_drives_a_few_metres_nothing_is_known():
    rng = np.random.default_rng(3)
    still = np.repeat(of_sensor(90.0)[:1], 300, axis=0)
    still[:, :3] += rng.normal(0.0, 0.05, (300, 3))
    assert find_other_forward_axis(still) is None
    assert find_other_forward_axis(of_sensor(90.0)[:8]) is None
    assert find_other_forward_axis(np.full((40, 7), np.nan)) is None


def test_poses_that_wander_in_all_directions_raise_no_alarm():
    rng = np.random.default_rng(4)
    poses = np.zeros((400, 7))
    poses[:, :3] = rng.normal(0.0, 3.0, (400, 3))
    poses[:, 3:] = Rotation.random(400, random_state=5).as_quat()
    assert find_other_forward_axis(poses) is None
