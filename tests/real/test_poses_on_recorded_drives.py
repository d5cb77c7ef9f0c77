"""Poses of recorded drives, right and wrong, against their scans."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.odometry.pose_check import check_poses
from core.odometry.posed_drive import PosedDrive
from core.scans.displacement import pose_beside
from core.scans.drive import MemoryDrive

pytestmark = pytest.mark.real_data
DRIVES = {"kitti00": 1.73, "kit_muehlburger": 1.73, "nclt_turn": 0.95, "kitti_drive0001": 1.73}
TO_CAMERA = Rotation.from_matrix([[0, -1, 0], [0, 0, -1], [1, 0, 0]])


@pytest.fixture(params=sorted(DRIVES))
def drive(request, drives):
    return drives.open(request.param)


def checked(drive, poses):
    found = check_poses(PosedDrive(drive, poses), DRIVES[drive.name])
    shown = (drive.name, found.agreeing, len(found.contradictions), found.is_wrong)
    print(*shown)  # noqa: T201 - with `-s` the figures of docs/reference/mapping-measurements.md
    return found


@pytest.mark.parametrize("every", [1, 2, 3])
def test_own_poses_raise_no_alarm(drive, every):
    scans = MemoryDrive(drive.name, [drive.scan(at) for at in range(0, len(drive), every)])
    found = checked(scans, scans.poses)
    assert found.contradictions == ()
    assert found.agreeing >= 3
    assert found.scale is None
    assert found.turned_deg is None


@pytest.mark.parametrize("scale", [0.8, 0.9, 1.1, 1.2])
def test_poses_of_another_scale_are_found_with_the_scale(drive, scale):
    found = checked(drive, drive.poses * ([scale] * 3 + [1.0] * 4))
    assert found.scale == pytest.approx(scale, rel=0.03)


@pytest.mark.parametrize("turned_deg", [-25.0, 10.0])
def test_poses_of_a_vehicle_on_which_the_sensor_is_turned_are_found_with_the_angle(
    drive, turned_deg
):
    poses = np.array([pose_beside(pose, 0.0, turned_deg) for pose in drive.poses])
    found = checked(drive, poses)
    assert not found.is_wrong
    assert found.turned_deg == pytest.approx(-turned_deg, abs=3.0)


def test_wrong_poses_are_found(drive, drives):
    own = np.array(drive.poses)
    turned = TO_CAMERA * Rotation.from_quat(own[:, 3:]) * TO_CAMERA.inv()
    wrong = {
        "reversed": own[::-1],
        "in feet": own * ([1.0 / 0.3048] * 3 + [1.0] * 4),
        "of the camera": np.hstack([TO_CAMERA.apply(own[:, :3]), turned.as_quat()]),
    }
    for name, poses in wrong.items():
        assert checked(drive, poses).is_wrong, name
    late = np.concatenate([own[5:], np.repeat(own[-1:], 5, axis=0)])
    assert checked(drive, late).contradictions or drive.name == "kitti_drive0001"  # it goes ahead
    for name in DRIVES.keys() - {drive.name}:
        other = drives.open(name).poses
        found = checked(drive, other[np.arange(len(own)) % len(other)])
        assert found.contradictions, name
