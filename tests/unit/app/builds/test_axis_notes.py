"""Notes on drives that do not have x forward and z up."""

import numpy as np
import pytest

from app.builds.axis_notes import axis_notes
from core.odometry.posed_drive import PosedDrive
from core.scans.drive import MemoryDrive
from core.scans.mounting import Mounting, vehicle_drive
from core.scans.pose import matrices_from_rows, rows_from_matrices
from core.scans.scan import Scan
from tests.support.recording import recording

HEIGHT_M = 1.73
LEVEL = MemoryDrive("monday", recording().scans)
TO_THE_RIGHT = Mounting(0.0, 0.0, HEIGHT_M, yaw_deg=-90.0)


def seen_by(mounting, drive=LEVEL):
    """Return a drive as a sensor of that mounting records it."""
    from_vehicle = Mounting(0.0, 0.0, HEIGHT_M, yaw_deg=-mounting.yaw_deg)
    scans = [Scan(from_vehicle.mount(scan, HEIGHT_M).points_m) for scan in drive]
    return PosedDrive(MemoryDrive("monday", scans), mounting.sensor_poses(drive.poses))


def test_a_drive_with_x_forward_and_z_up_gets_no_note():
    assert list(axis_notes([LEVEL], HEIGHT_M)) == []


@pytest.mark.parametrize("computed", [(), ("monday",)])
def test_a_drive_along_y_of_its_frame_is_noted_until_its_mounting_is_set(computed):
    drive = seen_by(TO_THE_RIGHT)
    [note] = axis_notes([drive], HEIGHT_M, computed)
    assert note.startswith("drive monday moves along +y of its frame in 100% of its steps")
    assert "turn the drive's mounting by yaw_deg -90 and build again" in note
    assert "a mounting has x_m, y_m and z_m, too" in note
    mounted = vehicle_drive(drive, TO_THE_RIGHT, HEIGHT_M, 1)
    assert list(axis_notes([mounted], HEIGHT_M, computed)) == []


def test_a_drive_backwards_may_be_a_vehicle_that_reversed():
    [note] = axis_notes([seen_by(Mounting(0.0, 0.0, HEIGHT_M, yaw_deg=180.0))], HEIGHT_M)
    assert "180 degrees off the direction of travel, unless the vehicle reversed all the" in note


@pytest.mark.parametrize(
    ("turn", "axis", "hint"),
    [
        ([[0, -1, 0], [0, 0, -1], [1, 0, 0]], "-y", "as KITTI's cameras: x, y, z become z, -x, -y"),
        ([[0, 1, 0], [1, 0, 0], [0, 0, -1]], "-z", "or do the quaternions begin with w"),
        ([[1, 0, 0], [0, 0, 1], [0, -1, 0]], "+y", "put them again"),
    ],
)
def test_poses_in_a_world_with_another_axis_up_are_noted(turn, axis, hint):
    """Between scans the motion is the same: nothing else finds them, and headings are wrong."""
    turn = np.array(turn, np.float64)
    matrices = matrices_from_rows(LEVEL.poses).copy()
    matrices[:, :3] = turn @ matrices[:, :3]
    [note] = axis_notes([PosedDrive(LEVEL, rows_from_matrices(matrices))], HEIGHT_M)
    assert note.startswith(f"drive monday: {axis} of the world of its poses points up")
    assert hint in note
