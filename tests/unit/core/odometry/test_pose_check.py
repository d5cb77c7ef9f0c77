import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.odometry.pose_check import check_poses
from core.odometry.posed_drive import PosedDrive
from core.scans.displacement import pose_beside, seen_from_beside
from core.scans.drive import MemoryDrive
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from tests.support.recording import recording

HEIGHT_M = 1.73
DRIVE = MemoryDrive("monday", recording().scans)
SHORT = MemoryDrive("monday", recording().scans[:24])
LIDAR_TO_CAMERA = Rotation.from_matrix([[0, -1, 0], [0, 0, -1], [1, 0, 0]])


def checked(poses, drive=DRIVE):
    return check_poses(PosedDrive(drive, poses), HEIGHT_M)


def scaled(poses, scale):
    return poses * ([scale] * 3 + [1.0] * 4)


def camera(poses):
    poses = np.array(poses)
    turned = LIDAR_TO_CAMERA * Rotation.from_quat(poses[:, 3:]) * LIDAR_TO_CAMERA.inv()
    return np.hstack([LIDAR_TO_CAMERA.apply(poses[:, :3]), turned.as_quat()])


WRONG = {
    "of another drive": lambda own: SimulatedDrive(seed=9, scans=60).poses[30 : 30 + len(own)],
    "reversed": lambda own: own[::-1],
    "in feet": lambda own: scaled(own, 1.0 / 0.3048),
    "of the camera": camera,
}


@pytest.mark.parametrize("every", [1, 2, 3])
def test_a_drives_own_poses_in_any_frame_are_confirmed(every):
    drive = MemoryDrive("monday", recording().scans[::every])
    turn = Rotation.from_euler("xyz", [5.0, -3.0, 70.0], degrees=True)
    own = np.array(drive.poses)
    poses = np.hstack(
        [turn.apply(own[:, :3]) + 500.0, (turn * Rotation.from_quat(own[:, 3:])).as_quat()]
    )
    found = checked(poses, drive)
    assert (found.agreeing, found.contradictions) == ({1: 8, 2: 4, 3: 2}[every], ())
    assert (found.is_wrong, found.is_unknown, found.turned_deg) == (False, False, None)


@pytest.mark.parametrize("of", sorted(WRONG))
def test_poses_that_are_not_those_of_the_scans_are_found(of):
    found = checked(np.array(WRONG[of](SHORT.poses)), SHORT)
    assert found.is_wrong
    for one in found.contradictions:
        assert one.by_scans.metres == pytest.approx(3.0, abs=1.6)


def test_a_contradiction_has_the_motion_by_poses_and_by_scans():
    first, *_ = checked(scaled(SHORT.poses, 10.0), SHORT).contradictions
    assert (first.first, first.last) == (0, 2)
    assert first.by_poses.metres == pytest.approx(30.0, abs=0.1)
    assert "scan 0 to 2: (30.0, 0.0, 0.0) m and 0 deg by the poses, (3.0, 0.0," in str(first)


def test_poses_that_are_a_few_scans_late_contradict_the_turns():
    late = np.concatenate([DRIVE.poses[5:], np.repeat(DRIVE.poses[-1:], 5, axis=0)])
    found = checked(late)
    assert found.contradictions
    assert found.agreeing


def test_a_sensor_that_is_tilted_on_the_vehicle_of_its_poses_raises_no_alarm():
    tilt = Rotation.from_euler("y", 12.0, degrees=True)
    scans = [
        Scan(tilt.inv().apply(scan.points_m).astype(np.float32), pose=scan.pose) for scan in SHORT
    ]
    assert not checked(SHORT.poses, MemoryDrive("monday", scans)).contradictions


@pytest.mark.parametrize("turned_deg", [-25.0, -12.0, 12.0, 25.0])
def test_a_sensor_that_is_turned_on_the_vehicle_of_its_poses_is_found_with_the_angle(turned_deg):
    poses = [pose_beside(pose, 0.0, turned_deg) for pose in DRIVE.poses]
    found = checked(np.array(poses))
    assert not found.is_wrong
    assert found.turned_deg == pytest.approx(-turned_deg, abs=3.0)


@pytest.mark.parametrize("heading_deg", [0.0, 30.0, 70.0, 200.0, 290.0])
def test_inverted_poses_of_a_straight_drive_are_found_whatever_its_heading(heading_deg):
    straight = MemoryDrive("monday", recording().scans[:12])
    turn = Rotation.from_euler("z", heading_deg, degrees=True)
    own = np.array(straight.poses)
    world = (turn * Rotation.from_quat(own[:, 3:])).inv()
    inverted = np.hstack([world.apply(-turn.apply(own[:, :3] - own[0, :3])), world.as_quat()])
    found = checked(inverted, straight)
    assert found.is_wrong or found.turned_deg is not None


@pytest.mark.parametrize(("left_m", "ahead_m"), [(-0.5, 0.0), (0.5, -0.5), (0.0, 2.0), (0.0, -2.0)])
def test_poses_of_an_antenna_beside_the_sensor_go_its_way(left_m, ahead_m):
    poses = [pose_beside(pose, left_m, ahead_m=ahead_m) for pose in DRIVE.poses]
    assert checked(np.array(poses)).turned_deg is None


@pytest.mark.parametrize("off_deg", [-4.0, 4.0])
def test_half_a_turn_to_the_left_by_the_poses_and_to_the_right_by_the_scans_agree(off_deg):
    # Every second scan is of a sensor that looks back, and its pose is off by less than is allowed.
    turned_deg = 180.0 * (np.arange(len(SHORT)) % 2)
    scans = [
        Scan.from_returns(seen_from_beside(scan.points_m, 0.0, turn_deg))
        for scan, turn_deg in zip(SHORT, turned_deg, strict=True)
    ]
    poses = np.array(
        [
            pose_beside(pose, 0.0, turn_deg + off_deg * (turn_deg > 0.0))
            for pose, turn_deg in zip(SHORT.poses, turned_deg, strict=True)
        ]
    )
    found = checked(poses, MemoryDrive("monday", scans))
    assert (found.agreeing, found.contradictions) == (4, ())


@pytest.mark.parametrize("why", ["keyframes", "few returns", "few poses"])
def test_what_cannot_be_measured_is_no_contradiction(why):
    scans, poses = DRIVE, scaled(DRIVE.poses, 10.0)
    if why == "keyframes":
        scans, poses = MemoryDrive("monday", recording().scans[::7]), poses[::7]
    elif why == "few returns":
        scans = MemoryDrive("monday", [Scan(scan.points_m[:40]) for scan in DRIVE])
    else:
        poses[5:] = np.nan
    found = checked(poses, scans)
    assert (found.agreeing, found.contradictions, found.is_wrong) == (0, (), False)
    assert found.is_unknown == (why != "few poses")
