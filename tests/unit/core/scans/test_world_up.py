"""Which axis of the world of poses points up."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.scans.mounting import Mounting
from core.scans.pose import UNKNOWN_POSE
from core.scans.world_up import WorldUp, find_other_world_up
from core.simulation import SimulatedDrive

POSES = SimulatedDrive(seed=5, scans=80).poses


def in_world(rotation, poses=POSES):
    """Return poses in another world, by the rotation from the one that they are in."""
    turned = rotation * Rotation.from_quat(poses[:, 3:].copy())
    return np.hstack([rotation.apply(poses[:, :3].copy()), turned.as_quat()])


@pytest.mark.parametrize(
    ("axis", "roll_deg", "pitch_deg"),
    [("-z", 180, 0), ("-y", 90, 0), ("+y", -90, 0), ("+x", 0, 90), ("-x", 0, -90)],
)
def test_the_axis_that_points_up_is_found(axis, roll_deg, pitch_deg):
    found = find_other_world_up(
        in_world(Rotation.from_euler("xy", [roll_deg, pitch_deg], degrees=True))
    )
    assert found == WorldUp(axis, 1.0)


def test_the_world_of_kittis_cameras_has_y_down():
    of_camera = Rotation.from_matrix([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
    assert find_other_world_up(in_world(of_camera)) == WorldUp("-y", 1.0)


@pytest.mark.parametrize("pitch_deg", [0.0, 15.0, -35.0])
def test_a_world_with_z_up_raises_no_alarm_nor_does_a_tilted_sensor(pitch_deg):
    tilted = Mounting(0.0, 0.0, 1.0, pitch_deg=pitch_deg).sensor_poses(POSES)
    assert find_other_world_up(tilted) is None


def test_unknown_poses_change_nothing_and_two_are_too_few():
    wrong = in_world(Rotation.from_euler("x", 180, degrees=True))
    some = wrong.copy()
    some[5:70] = UNKNOWN_POSE
    assert find_other_world_up(some) == WorldUp("-z", 1.0)
    assert find_other_world_up(wrong[:2]) is None
    assert find_other_world_up(np.full_like(wrong, np.nan)) is None
