"""Scans away from one: by metres where poses are known, by scans where they are not."""

import numpy as np
import pytest

from core.confidence.places import away_from
from core.scans.trajectory import Trajectory
from tests.support.samples import straight_poses


@pytest.fixture
def poses():
    return straight_poses(8, step_m=4.0)


def away(poses, row):
    drives = Trajectory(
        ("a", "b"), np.array([0, 5, 8]), np.array([0, 1, 2, 30, 99, 0, 1, 2]), np.arange(8.0), poses
    )
    return np.flatnonzero(away_from(drives, row, metres=10.0, scans=20)).tolist()


def test_where_all_poses_are_known_metres_decide_in_all_drives(poses):
    assert away(poses, 3) == [0, 6, 7]


def test_a_scan_without_a_pose_is_away_by_its_index_or_in_another_drive(poses):
    poses[[4, 5]] = np.nan
    assert away(poses, 3) == [0, 4, 5, 6, 7]
    assert away(poses, 4) == [0, 1, 2, 3, 5, 6, 7]


def test_height_counts_too(poses):
    poses[2, 2] = 50.0
    assert away(poses, 3) == [0, 2, 6, 7]
