"""A mounted sensor's queries are answered with the vehicle's pose."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core import Localizer, MapParameters, MemoryDrive, Mounting, accumulate
from core.mapping.pipeline import build
from core.scans.angles import wrapped_deg
from core.scans.mounting import vehicle_drive
from tests.support.mounted import ASKEW, mounted_recording, vehicle_poses
from tests.support.recording import recording

HEIGHT_M = 1.73


def map_of(drive, **options):
    """Return a map without a probability, on which no test here depends."""
    return build([drive], MapParameters.for_sensor(), calibrated=False, **options).tensor_map


@pytest.fixture(scope="module")
def localizer():
    """A map of another, level sensor in the middle of the vehicle."""
    return Localizer(map_of(MemoryDrive("monday", recording().scans)))


def errors(found, index):
    """Return how far an estimated pose is from the vehicle's, metres and degrees."""
    x_m, y_m = vehicle_poses()[index, :2]
    yaw = Rotation.from_quat(vehicle_poses()[index, 3:]).as_euler("xyz", degrees=True)[2]
    pose = found.best.estimated_pose
    return np.hypot(pose.x_m - x_m, pose.y_m - y_m), abs(wrapped_deg(pose.yaw_deg - yaw))


def test_the_answer_to_a_mounted_sensor_is_the_vehicles_pose(localizer):
    drive = mounted_recording()
    found = [
        errors(localizer.localize_scan(ASKEW.mount(drive.scan(index), HEIGHT_M)), index)
        for index in range(3, 45, 6)
    ]
    off_m, off_deg = np.transpose(found)
    assert np.median(off_m) < 1.0
    assert off_m.max() < 3.0
    assert off_deg.max() < 3.0


def test_without_its_mounting_the_heading_is_the_sensors(localizer):
    # Level, so that the place is found nevertheless.
    turned = Mounting(0.0, 0.0, HEIGHT_M, yaw_deg=120.0)
    scan = mounted_recording(turned).scan(20)
    _, off_deg = errors(localizer.localize_scan(scan), 20)
    assert off_deg == pytest.approx(120.0, abs=3.0)
    _, off_deg = errors(localizer.localize_scan(turned.mount(scan, HEIGHT_M)), 20)
    assert off_deg < 3.0


def test_sparse_scans_of_a_mounted_sensor_together_find_the_vehicles_pose(localizer):
    """The odometry is the vehicle's, in a frame of its own."""
    drive = mounted_recording(sparse=True)
    start = Rotation.from_euler("z", 77.0, degrees=True)
    odometry = vehicle_poses().copy()
    odometry[:, :3] = start.apply(odometry[:, :3] - odometry[0, :3]) + np.array([5.0, -3.0, 9.0])
    odometry[:, 3:] = (start * Rotation.from_quat(odometry[:, 3:])).as_quat()
    found = []
    for last in range(8, 45, 6):
        window = slice(last - 7, last + 1)
        scans = [drive.scan(index) for index in range(window.start, window.stop)]
        scan = accumulate(scans, ASKEW.sensor_poses(odometry[window]))
        answer = localizer.localize_scan(ASKEW.mount(scan, HEIGHT_M))
        found.append(errors(answer, last))
    off_m, off_deg = np.transpose(found)
    assert np.median(off_m) < 1.5
    assert np.median(off_deg) < 3.0


def test_a_map_of_a_mounted_drive_answers_another_sensor_with_the_vehicles_pose():
    drive = vehicle_drive(mounted_recording(), ASKEW, HEIGHT_M)
    tensor_map = map_of(drive)
    np.testing.assert_allclose(tensor_map.trajectory.poses, vehicle_poses(), atol=1e-9)
    other = Localizer(tensor_map)
    for index in (5, 20, 40):
        off_m, off_deg = errors(other.localize_scan(recording().scans[index]), index)
        assert off_m < 2.0
        assert off_deg < 3.0


def test_a_map_of_accumulated_scans_has_the_pose_of_the_last_of_each():
    drive = vehicle_drive(mounted_recording(sparse=True), ASKEW, HEIGHT_M, accumulate=6)
    tensor_map = map_of(drive, segments=2)
    ends = np.arange(5, 48, 6)
    assert tensor_map.trajectory.scan_index.tolist() == ends.tolist()
    np.testing.assert_allclose(tensor_map.trajectory.poses, vehicle_poses()[ends], atol=1e-9)
