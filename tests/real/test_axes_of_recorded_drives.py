"""Which axis of the sensor is up, and forward, on recorded drives, as they are and turned."""

import numpy as np
import pytest

from core.projection.up_axis import find_other_up_axis
from core.scans.drive import MemoryDrive
from core.scans.forward_axis import find_other_forward_axis
from core.scans.mounting import Mounting
from core.scans.scan import Scan

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


def test_the_velodyne_of_nclt_turn_is_turned_on_its_robot_and_all_others_look_ahead(drive):
    found = find_other_forward_axis(drive.poses)
    assert (None if found is None else found.axis) == ("-y" if drive.name == "nclt_turn" else None)
    yaw_deg = 0.0 if found is None else found.yaw_deg
    mounting = Mounting(0.0, 0.0, HEIGHTS_M[drive.name], yaw_deg=yaw_deg)
    assert find_other_forward_axis(mounting.vehicle_poses(drive.poses)) is None
