"""Which axis of the sensor is up, and forward, on recorded drives, as they are and turned."""

import numpy as np
import pytest

from core.projection.ground_offset import find_ground_offset
from core.projection.up_axis import find_other_up_axis, find_other_up_axis_of_scan
from core.scans.drive import MemoryDrive
from core.scans.forward_axis import find_other_forward_axis
from core.scans.mounting import Mounting
from core.scans.scan import Scan
from core.scans.world_up import find_other_world_up

pytestmark = pytest.mark.real_data
HEIGHTS_M = {"kitti00": 1.73, "kit_muehlburger": 1.73, "nclt_turn": 0.95, "kitti_drive0001": 1.73}
UP = {
    "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "+y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "-y": [[0, -1, 0], [0, 0, -1], [1, 0, 0]],
}


@pytest.fixture(params=sorted(HEIGHTS_M))
def drive(request, drives):
    return drives.open(request.param)


def parts(drive):
    """Yield the drive in parts of ten scans, of which each scan is looked at."""
    for first in range(0, len(drive) - 9, 60):
        yield [drive.scan(at) for at in range(first, first + 10)]


@pytest.mark.parametrize("of_height", [0.5, 1.0, 2.0])
def test_no_part_of_a_drive_has_another_axis_up(drive, of_height):
    height_m = of_height * HEIGHTS_M[drive.name]
    for scans in parts(drive):
        assert find_other_up_axis(MemoryDrive(drive.name, scans), height_m) is None


@pytest.mark.parametrize("axis", UP)
def test_turned_drives_are_found(drive, axis):
    axes = np.array(UP[axis], np.float64)
    found = []
    for scans in parts(drive):
        turned = [Scan.from_returns(scan.points_m @ axes.T) for scan in scans]
        found.append(find_other_up_axis(MemoryDrive(drive.name, turned), HEIGHTS_M[drive.name]))
    print(drive.name, axis, sum(one is not None for one in found), len(found))  # noqa: T201 - `-s`
    assert {one.axis for one in found if one is not None} == {axis}
    assert sum(one is not None for one in found) >= 0.9 * len(found)


@pytest.mark.parametrize("of_height", [0.5, 1.0, 2.0])
def test_no_scan_of_a_drive_has_another_axis_up(drive, of_height):
    """Nor has a narrow one, one that hardly sees below the horizon, or one without its ground."""
    height_m = of_height * HEIGHTS_M[drive.name]
    for at in range(0, len(drive), 8):
        points_m = drive.scan(at).points_m
        x, y, z = points_m.T
        up = np.degrees(np.arctan2(z, np.hypot(x, y)))
        parts = points_m, points_m[up > -7], points_m[up > -3], points_m[y > np.abs(x)]
        for part_m in (*parts, points_m[z > 0.3 - HEIGHTS_M[drive.name]]):
            assert find_other_up_axis_of_scan(part_m, height_m) is None


@pytest.mark.parametrize("axis", UP)
def test_turned_scans_are_found(drive, axis):
    axes = np.array(UP[axis], np.float64)
    found = []
    for at in range(0, len(drive), 8):
        turned = Scan.from_returns(drive.scan(at).points_m @ axes.T)
        found.append(find_other_up_axis_of_scan(turned.points_m, HEIGHTS_M[drive.name]))
    print(drive.name, axis, sum(one is not None for one in found), len(found))  # noqa: T201 - `-s`
    assert {one.axis for one in found if one is not None} == {axis}
    assert sum(one is not None for one in found) >= 0.75 * len(found)


def test_the_world_of_a_drives_poses_has_z_up(drive):
    assert find_other_world_up(drive.poses) is None


def test_the_velodyne_of_nclt_turn_is_turned_on_its_robot_and_all_others_look_ahead(drive):
    found = find_other_forward_axis(drive.poses)
    assert (None if found is None else found.axis) == ("-y" if drive.name == "nclt_turn" else None)
    yaw_deg = 0.0 if found is None else found.yaw_deg
    mounting = Mounting(0.0, 0.0, HEIGHTS_M[drive.name], yaw_deg=yaw_deg)
    assert find_other_forward_axis(mounting.vehicle_poses(drive.poses)) is None


@pytest.mark.parametrize("of_height", [0.6, 1.0, 1.5])
def test_the_ground_of_no_part_of_a_drive_is_far_from_its_mounting(drive, of_height):
    height_m = of_height * HEIGHTS_M[drive.name]
    for scans in parts(drive):
        part = MemoryDrive(drive.name, scans)
        assert find_ground_offset(part, None, height_m) is None
        assert find_ground_offset(part, Mounting(0, 0, height_m, yaw_deg=90), 1.73) is None


@pytest.mark.parametrize("pitch_deg", [-30.0, 25.0])
def test_a_pitch_that_the_sensor_does_not_have_is_found(drive, pitch_deg):
    mounting = Mounting(0.0, 0.0, HEIGHTS_M[drive.name], pitch_deg=pitch_deg)
    found = find_ground_offset(drive, mounting, 1.73)
    assert found is not None
    assert found.tilt_deg == pytest.approx(abs(pitch_deg), abs=2.5)
    assert found.height_m is None


@pytest.mark.parametrize("stated_m", [5.0, 6.0])
def test_a_height_that_the_sensor_does_not_have_is_found(drive, stated_m):
    for found in (
        find_ground_offset(drive, None, stated_m),
        find_ground_offset(drive, Mounting(0.0, 0.0, stated_m), 1.73),
    ):
        assert found is not None
        assert found.tilt_deg is None
        assert found.height_m == pytest.approx(HEIGHTS_M[drive.name], abs=0.25)
