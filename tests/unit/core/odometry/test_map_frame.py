import numpy as np
import pytest

from core.odometry.map_frame import is_in_map_frame
from core.odometry.posed_drive import PosedDrive
from core.scans.drive import MemoryDrive
from core.scans.scan import Scan
from tests.support.recording import recording
from tests.support.registered import registered

SCANS = recording().scans


@pytest.mark.parametrize("scans", [SCANS, SCANS[:16], SCANS[::6]])
def test_registered_scans_are_distinguished_from_those_of_the_sensor(scans):
    assert is_in_map_frame(MemoryDrive("monday", [registered(scan) for scan in scans]))
    assert not is_in_map_frame(MemoryDrive("monday", scans))


def test_a_narrow_view_alone_is_no_registered_scan():
    ahead = [
        Scan(scan.points_m[scan.points_m[:, 0] > np.abs(scan.points_m[:, 1])], pose=scan.pose)
        for scan in SCANS
    ]
    assert not is_in_map_frame(MemoryDrive("monday", ahead))


@pytest.mark.parametrize("known", [0, 1, len(SCANS)], ids=["no pose", "one pose", "stands"])
def test_poses_that_show_no_motion_leave_it_open(known):
    poses = np.full((len(SCANS), 7), np.nan)
    poses[:known] = MemoryDrive("monday", SCANS).poses[0]
    registered_scans = MemoryDrive("monday", [registered(scan) for scan in SCANS])
    assert not is_in_map_frame(PosedDrive(registered_scans, poses))
