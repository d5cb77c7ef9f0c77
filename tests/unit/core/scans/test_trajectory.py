"""Trajectories of one or more drives: what is rejected, joined and selected."""

import math

import numpy as np
import pytest

from core.errors import EmptyDrive, InvalidMap
from core.scans.path import path_length_m
from core.scans.trajectory import Trajectory
from tests.support.samples import straight_poses, two_drives


def with_row(row):
    poses = straight_poses(5)
    poses[2] = row
    return poses


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"drive_start": [0, 5]}, "does not cut 5 scans into 2 drives"),
        ({"drive_start": [1, 2, 5]}, "does not cut"),
        ({"drive_start": [0, 2, 4]}, "does not cut"),
        ({"drive_start": [0, 5, 5]}, "does not cut"),
        ({"drive_start": [[0, 2, 5]]}, "does not cut"),
        ({"drive_start": [0, 6, 5]}, "does not cut"),
        ({"drives": ("a",)}, "does not cut 5 scans into 1 drives"),
        ({"drives": ("a", "")}, "names"),
        ({"drives": ("a", 5)}, "names"),
        ({"scan_index": [[3], [7], [0], [1], [2]]}, "scan_index has shape"),
        ({"scan_index": [3, 7, -1, 0, 1]}, "scan_index does not rise from 0 or more"),
        ({"scan_index": [3, 3, 0, 1, 2]}, "scan_index does not rise"),
        ({"scan_index": [3, 7, 1, 0, 2]}, "scan_index does not rise"),
        ({"timestamp_s": np.arange(4.0)}, r"timestamp_s has shape \(4,\), wanted \(5,\)"),
        ({"timestamp_s": [0, 1, np.inf, 3, 4]}, "timestamp_s has infinite"),
        ({"poses": straight_poses(4)}, r"poses has shape \(4, 7\), wanted \(5, 7\)"),
        ({"poses": with_row([1, 2, 3, 0, 0, 0, 0])}, "row 2 is no pose"),
        ({"poses": with_row([np.nan, 2, 3, 0, 0, 0, 1])}, "row 2 is no pose"),
        ({"poses": with_row([np.inf, 2, 3, 0, 0, 0, 1])}, "row 2 is no pose"),
    ],
)
def test_an_invalid_trajectory_is_rejected(wrong, message):
    with pytest.raises(InvalidMap, match=message):
        two_drives(**wrong)


def test_a_trajectory_is_shown_in_a_line_without_arrays():
    shown = repr(two_drives(poses=with_row(np.full(7, np.nan))))
    assert shown == "Trajectory(scans=5, drives=('a', 'b'), posed=4)"


def test_the_rows_of_a_drive_are_those_of_its_scans():
    trajectory = two_drives()
    assert [trajectory.rows_of(name) for name in "ab"] == [slice(0, 2), slice(2, 5)]
    with pytest.raises(ValueError, match="not in tuple"):
        trajectory.rows_of("c")


def test_a_trajectory_needs_a_scan():
    with pytest.raises(EmptyDrive):
        Trajectory((), [0], [], [], np.empty((0, 7)))  # type: ignore[arg-type]
    with pytest.raises(EmptyDrive, match="no drive to map"):
        Trajectory.concatenate([])


def test_a_trajectory_has_the_drive_of_each_scan():
    assert two_drives().drive_of_scan.tolist() == [0, 0, 1, 1, 1]
    assert len(two_drives()) == 5
    assert two_drives(poses=with_row([np.nan] * 7)).known.tolist() == [
        True,
        True,
        False,
        True,
        True,
    ]


def test_trajectories_one_after_another_keep_drives_apart():
    joined = Trajectory.concatenate([two_drives(), two_drives(drives=("c", "d"))])
    assert joined.drives == ("a", "b", "c", "d")
    assert joined.drive_start.tolist() == [0, 2, 5, 7, 10]
    assert joined.scan_index.tolist() == [3, 7, 0, 1, 2] * 2
    assert joined.drive_of_scan.tolist() == [0, 0, 1, 1, 1, 2, 2, 3, 3, 3]


def test_a_selection_leaves_out_drives_left_empty():
    chosen = two_drives().select(np.array([2, 4]))
    assert chosen.drives == ("b",)
    assert chosen.drive_start.tolist() == [0, 2]
    assert chosen.scan_index.tolist() == [0, 2]
    assert chosen.poses[:, 0].tolist() == [2.0, 4.0]


def test_the_reach_of_a_scan_is_half_of_the_longer_step_in_its_drive_and_a_lane():
    poses = straight_poses(8)
    poses[:, 0] = [0.0, 1.0, 13.0, 15.0, 15.0, 500.0, 501.0, 900.0]
    poses[3] = np.nan
    parts = (("a", poses[:7]), ("b", poses[7:]))
    drives = Trajectory.concatenate(
        [Trajectory.of_drive(name, rows[:, 0], rows, np.arange(len(rows))) for name, rows in parts]
    )
    assert drives.reach_m.tolist() == [5.0, 9.5, 9.5, 5.0, 18.5, 18.5, 5.0, 5.0]


def test_a_path_between_rows_is_that_of_their_poses_and_unknown_where_one_is():
    poses = straight_poses(6, step_m=2.0)
    poses[:, 2] = np.array([0.0, 1.0, -1.0, 3.0, 0.0, 2.0])
    poses[4] = np.nan
    trajectory = Trajectory.of_drive("d", np.arange(6.0), poses, np.arange(6))
    assert trajectory.path_m(0, 3) == path_length_m(poses[:4])
    assert trajectory.path_m(2, 2) == 0.0
    assert math.isnan(trajectory.path_m(2, 4))
    assert math.isnan(trajectory.path_m(4, 4))
