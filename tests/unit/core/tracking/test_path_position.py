"""Where on the path between scans a vehicle is, by its belief and by its estimated pose."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from core.localization.match import Match
from core.scans.pose import Pose
from core.scans.trajectory import Trajectory
from core.tracking.path_position import with_estimate

OF_FOUR_METRES_M2 = 4.0**2 / 12.0
SHARE = OF_FOUR_METRES_M2 / (OF_FOUR_METRES_M2 + 0.3**2)


def trajectory_of(along_m: list[float], drives: tuple[int, ...] = ()) -> Trajectory:
    """Return drives along the x axis; each but the first begins at a row of `drives`."""
    poses = np.zeros((len(along_m), 7))
    poses[:, 0], poses[:, 6] = along_m, 1.0
    starts = [0, *drives, len(along_m)]
    return Trajectory.concatenate(
        [
            Trajectory.of_drive(
                f"drive-{start}",
                np.full(end - start, np.nan),
                poses[start:end],
                np.arange(end - start),
            )
            for start, end in pairwise(starts)
        ]
    )


def position(
    trajectory: Trajectory,
    row: int,
    ahead_m: float | None,
    *,
    belief: float = 0.0,
    of_row_m2: float = OF_FOUR_METRES_M2,
) -> float:
    """Return the position of a vehicle whose pose is so far ahead of a scan, and 1 m beside it."""
    pose = Pose.from_row(trajectory.poses[row])
    assert pose is not None
    match = Match(
        segment=0,
        fraction=0.0,
        along_m=None,
        drive=trajectory.drives[int(trajectory.drive_of_scan[row])],
        scan_index=0,
        row=row,
        distance=0.1,
        timestamp_s=None,
        pose=pose,
        estimated_pose=None if ahead_m is None else replace(pose, x_m=pose.x_m + ahead_m, y_m=1.0),
    )
    return with_estimate(row + belief, match, trajectory, of_row_m2)


@pytest.mark.parametrize(("ahead_m", "rows"), [(1.0, 0.25), (-1.6, -0.4), (0.0, 0.0)])
def test_between_scans_far_apart_a_vehicle_is_where_its_pose_is(ahead_m, rows):
    found = position(trajectory_of([0.0, 4.0, 8.0, 12.0]), 1, ahead_m, belief=0.4)
    assert found == pytest.approx(1.4 + SHARE * (rows - 0.4))


@pytest.mark.parametrize("ahead_m", [2.5, 30.0, -2.5, -30.0])
def test_a_pose_beyond_half_of_the_way_to_a_scan_is_not_followed_to_that_scan(ahead_m):
    found = position(trajectory_of([0.0, 4.0, 8.0, 12.0]), 1, ahead_m)
    assert found == pytest.approx(1.0 + 0.5 * SHARE * np.sign(ahead_m))


@pytest.mark.parametrize("row", [1, 2])
def test_no_vehicle_is_between_two_drives_or_where_one_was_interrupted(row):
    towards_m = 1.0 if row == 1 else -1.0
    assert position(trajectory_of([0.0, 4.0, 8.0, 12.0], drives=(2,)), row, towards_m) == row
    assert position(trajectory_of([0.0, 4.0, 24.0, 28.0]), row, towards_m) == row
    assert position(trajectory_of([0.0, 4.0, 8.0, 12.0]), row, towards_m) != row


def test_towards_a_scan_that_no_estimate_reaches_the_belief_is_the_position():
    far = trajectory_of([0.0, 12.0, 24.0, 36.0])
    assert position(far, 1, 5.0, belief=0.4) == 1.4
    trajectory = trajectory_of([0.0, 4.0, 8.0])
    poses = trajectory.poses.copy()
    poses[2] = np.nan
    unknown = replace(trajectory, poses=poses)
    assert position(unknown, 1, 1.6, belief=0.4) == 1.4
    assert position(unknown, 1, -1.0, belief=-0.4) == pytest.approx(0.6 + SHARE * 0.15)


@pytest.mark.parametrize("side", [-1, 1])
def test_where_a_drive_turns_back_a_vehicle_stays_on_the_side_where_it_is_believed_to_be(side):
    found = position(trajectory_of([4.0, 8.0, 4.0]), 1, -1.6, belief=0.4 * side)
    assert found == pytest.approx(1.0 + 0.4 * side)


@pytest.mark.parametrize("row", [0, 3])
def test_before_the_first_scan_and_after_the_last_one_is_no_path(row):
    outward_m = -1.0 if row == 0 else 1.0
    trajectory = trajectory_of([0.0, 4.0, 8.0, 12.0])
    assert position(trajectory, row, outward_m) == row
    assert position(trajectory, row, -outward_m) != row


def test_in_a_stand_and_without_an_estimate_the_belief_is_the_position():
    trajectory = trajectory_of([0.0, *np.full(20, 4.0), 8.0])
    assert trajectory.stands[2].tolist() == [1, 20]
    assert position(trajectory, 2, 1.0, belief=0.25) == 2.25
    assert position(trajectory, 21, None, belief=-0.25) == 20.75


def test_of_scans_near_each_other_the_belief_is_the_more_exact_one():
    trajectory = trajectory_of([0.0, 0.2, 0.4, 0.6])
    assert position(trajectory, 1, 0.1, of_row_m2=0.2**2 / 12.0) == pytest.approx(1.0, abs=0.05)
