"""Scans away from one: by metres where poses are known, by scans where they are not."""

import numpy as np
import pytest

from core.confidence.places import CLOSE_SCANS, away_from, close_along_m, elsewhere_from
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


def elsewhere(poses, row):
    """Return the scans elsewhere of two drives of 60 scans."""
    parts = [
        Trajectory.of_drive(name, np.full(60, np.nan), rows, np.arange(60))
        for name, rows in (("a", poses[:60]), ("b", poses[60:]))
    ]
    return np.flatnonzero(elsewhere_from(Trajectory.concatenate(parts), row)).tolist()


def test_a_drive_without_poses_is_not_known_to_be_elsewhere():
    poses = straight_poses(120)
    poses[60:] = np.nan
    assert elsewhere(poses, 10) == list(range(35, 60))
    assert elsewhere(poses, 65) == list(range(115, 120))


def test_where_no_scan_has_a_pose_other_drives_are_elsewhere_of_short_ones_only():
    assert elsewhere(np.full((120, 7), np.nan), 5) == list(range(55, 60))
    assert elsewhere(np.full((120, 7), np.nan), 30) == list(range(60, 120))


def test_how_far_ahead_scans_are_is_along_the_heading_of_the_one():
    north = np.zeros((9, 7))
    north[:, 1], north[:, 5:] = np.arange(9.0), np.sqrt(0.5)  # headed north
    drive = Trajectory.of_drive("north", np.full(9, np.nan), north, np.arange(9))
    rows, along_m = close_along_m(drive, 3) or pytest.fail("the pose is known")
    assert rows.tolist() == list(range(9))
    np.testing.assert_allclose(along_m, np.arange(-3.0, 6.0), atol=1e-9)


def test_of_many_scans_around_one_some_are_compared_and_always_itself(poses):
    count = 1000
    still = Trajectory.of_drive(
        "still", np.full(count, np.nan), poses[np.zeros(count, int)], np.arange(count)
    )
    for row in range(0, count, 37):
        rows, _ = close_along_m(still, row) or pytest.fail("the pose is known")
        assert row in rows
        assert len(rows) <= CLOSE_SCANS + 1
