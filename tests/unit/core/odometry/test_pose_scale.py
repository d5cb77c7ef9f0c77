"""Poses that say a longer or shorter way than the scans."""

import numpy as np
import pytest

from core.odometry.pose_check import check_poses
from core.odometry.posed_drive import PosedDrive
from core.scans.drive import MemoryDrive
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from tests.support.recording import recording

HEIGHT_M = 1.73
DRIVE = MemoryDrive("monday", recording().scans)


def scale(drive, of_positions=1.0):
    poses = np.array(drive.poses)
    poses[:, :3] *= of_positions
    return check_poses(PosedDrive(drive, poses), HEIGHT_M).scale


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_poses_of_another_scale_are_found_with_the_scale(factor):
    assert scale(DRIVE, factor) == pytest.approx(factor, rel=0.03)


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("seed", [2, 7])
def test_right_poses_have_no_scale(seed, every):
    drive = SimulatedDrive(seed=seed, scans=40)
    scans = [drive.scan(at) for at in range(0, len(drive), every)]
    assert scale(MemoryDrive("simulated", scans)) is None


def test_poses_to_a_few_percent_have_no_scale():
    assert scale(DRIVE, 1.04) is None
    assert scale(DRIVE, 0.96) is None


@pytest.mark.parametrize("scans", [0, 1, 2, 8])
def test_a_drive_that_is_too_short_has_no_scale(scans):
    assert scale(MemoryDrive("short", recording().scans[:scans]), 1.2) is None


def test_a_vehicle_that_stands_has_no_scale():
    scans = [recording().scans[0]] * 30
    assert scale(MemoryDrive("stop", scans), 1.2) is None


def test_scans_that_do_not_show_how_far_the_sensor_moved_have_no_scale():
    walls = np.mgrid[-40:40:0.3, -6:7:12, -1:4:0.5].reshape(3, -1).T
    rng = np.random.default_rng(1)
    scans = [
        Scan.from_returns(walls + rng.normal(0.0, 0.02, walls.shape), pose=scan.pose)
        for scan in recording().scans
    ]
    assert scale(MemoryDrive("tunnel", scans), 1.2) is None
