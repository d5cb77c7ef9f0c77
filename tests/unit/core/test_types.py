"""Scans, poses, trajectories and graphs refuse nonsense at birth and say what was wanted."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.arrays import frozen
from core.errors import EmptyDrive, InvalidMap, InvalidPose, InvalidScan, TooFewReturns
from core.scans.drive import MemoryDrive
from core.scans.pose import (
    Pose,
    heading_deg,
    is_known,
    path_length_m,
    pose_rows,
    rows_from_matrices,
)
from core.scans.scan import Scan
from core.scans.trajectory import Trajectory
from core.topology import Topology
from tests.support.samples import straight_poses

POINTS = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], dtype=np.float32)


# Scan


@pytest.mark.parametrize("shape", [(3,), (2, 2), (2, 4), (1, 2, 3), (0,)])
def test_a_scan_is_n_by_3(shape):
    with pytest.raises(InvalidScan, match=r"wanted \(n, 3\)"):
        Scan(np.ones(shape, np.float32))
    with pytest.raises(InvalidScan, match=r"wanted \(n, 3\)"):
        Scan.from_returns(np.ones(shape))


@pytest.mark.parametrize("row", [[np.nan, 1, 1], [np.inf, 1, 1], [0, 0, 0], [0, -0.0, 0]])
def test_a_scan_holds_finite_returns_away_from_the_origin_only(row):
    with pytest.raises(InvalidScan, match="not finite or zero"):
        Scan(np.array([row, [1, 2, 3]], dtype=np.float32))
    scan = Scan.from_returns(np.array([row, [1.0, 2.0, 3.0]]))
    assert (len(scan), scan.dropped_returns) == (1, 1)


def test_a_coordinate_beyond_float32_is_no_return():
    assert Scan.from_returns([[1e300, 0.0, 0.0], [1.0, 0.0, 0.0]]).dropped_returns == 1
    with pytest.raises(InvalidScan, match="not finite"):
        Scan(np.array([[1e300, 0, 0]]))


def test_too_few_returns_are_counted():
    with pytest.raises(TooFewReturns, match="1 of 2 returns are finite and non-zero, at least 2"):
        Scan.from_returns([[1, 2, 3], [0, 0, 0]], min_returns=2)
    with pytest.raises(TooFewReturns, match="0 of 0"):
        Scan.from_returns(np.empty((0, 3)))


@pytest.mark.parametrize("timestamp_s", [math.inf, -math.inf])
def test_a_time_is_a_number_of_seconds_or_unknown(timestamp_s):
    with pytest.raises(InvalidScan, match="timestamp_s is"):
        Scan(POINTS, timestamp_s=timestamp_s)


def test_a_scan_cannot_be_written_through_and_leaves_its_callers_array_writable():
    points = POINTS.copy()
    scan = Scan(points)
    with pytest.raises(ValueError, match="read-only"):
        scan.points_m[0, 0] = 9.0
    points[0, 0] = 9.0


def test_freezing_what_is_frozen_copies_nothing():
    once = frozen(POINTS, np.float32)
    assert frozen(once, np.float32) is once


# Pose


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (0, 0, 0, 2), (1, 1, 1, 1)])
def test_a_pose_is_a_unit_quaternion(quaternion):
    with pytest.raises(InvalidPose, match=r"norm .*, wanted 1"):
        Pose(1.0, 2.0, 3.0, *quaternion)


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("place", range(7))
def test_a_pose_is_seven_finite_numbers(place, value):
    numbers = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    numbers[place] = value
    with pytest.raises(InvalidPose, match="seven finite numbers"):
        Pose(*numbers)
    with pytest.raises(InvalidPose):
        Pose.from_row(numbers)


@pytest.mark.parametrize("x_m", [1.1e8, -1e300])
def test_a_pose_lies_on_earth(x_m):
    with pytest.raises(InvalidPose, match="at most 1e"):
        Pose(x_m, 0.0, 0.0)


def test_a_row_of_nan_is_no_pose():
    assert Pose.from_row([math.nan] * 7) is None
    with pytest.raises(InvalidPose, match=r"shape \(6,\), wanted \(7,\)"):
        Pose.from_row([0.0] * 6)


@pytest.mark.parametrize("seed", range(5))
def test_a_matrix_and_its_pose_are_the_same_motion(seed):
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=seed)
    matrix = np.column_stack([rotation.as_matrix(), rng.normal(size=3)])
    pose = Pose.from_matrix(matrix)
    row = np.array(pose.as_tuple())
    np.testing.assert_allclose(Rotation.from_quat(row[3:]).as_matrix(), matrix[:, :3], atol=1e-12)
    np.testing.assert_allclose(row[:3], matrix[:, 3])
    forward = rotation.apply([1.0, 0.0, 0.0])
    assert pose.yaw_deg == pytest.approx(math.degrees(math.atan2(forward[1], forward[0])))


@pytest.mark.parametrize("yaw_deg", [-179.0, -90.0, 0.0, 45.0, 180.0])
def test_the_heading_is_the_yaw_of_the_quaternion(yaw_deg):
    row = np.concatenate([[0, 0, 0], Rotation.from_euler("z", yaw_deg, degrees=True).as_quat()])
    assert heading_deg(row[None])[0] == pytest.approx(yaw_deg)


def test_unknown_matrices_stay_unknown():
    matrices = np.stack([np.eye(4), np.full((4, 4), np.nan)])
    rows = rows_from_matrices(matrices)
    assert is_known(rows).tolist() == [True, False]
    assert np.isnan(rows[1]).all()
    assert rows_from_matrices(np.empty((0, 3, 4))).shape == (0, 7)


@pytest.mark.parametrize(
    "matrix", [2 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.zeros((3, 4)), 1e200 * np.eye(4)]
)
def test_a_matrix_that_scales_or_mirrors_is_no_pose(matrix):
    with pytest.raises(InvalidPose, match="no rotation"):
        Pose.from_matrix(matrix)


@pytest.mark.parametrize("shape", [(3, 3), (4, 3), (2, 2)])
def test_a_matrix_of_another_shape_is_no_pose(shape):
    with pytest.raises(InvalidPose, match=r"wanted \(3, 4\) or \(4, 4\)"):
        Pose.from_matrix(np.ones(shape))


def test_a_path_is_as_long_as_its_steps_and_unknown_where_a_pose_is():
    rows = straight_poses(5, step_m=2.0)
    assert path_length_m(rows) == 8.0
    assert path_length_m(rows[:1]) == 0.0
    rows[3] = np.nan
    assert math.isnan(path_length_m(rows))
    assert math.isnan(path_length_m(rows[3:4]))


def test_poses_stack_into_rows():
    rows = pose_rows([Pose(1.0, 2.0, 3.0), None])
    assert rows.shape == (2, 7)
    assert is_known(rows).tolist() == [True, False]
    assert pose_rows([]).shape == (0, 7)


# Drive


def test_a_drive_in_memory_gives_its_scans_in_order():
    drive = MemoryDrive("d", [Scan(POINTS, timestamp_s=1.0), Scan(POINTS, pose=Pose(1, 2, 3))])
    assert len(drive) == len(list(drive)) == 2
    np.testing.assert_array_equal(drive.timestamp_s, [1.0, np.nan])
    assert is_known(drive.poses).tolist() == [False, True]
    assert drive.scan(1).pose == Pose(1, 2, 3)
    for index in (-1, 2):
        with pytest.raises(IndexError):
            drive.scan(index)


# Trajectory


def trajectory(**changes):
    parts = {
        "drives": ("a", "b"),
        "drive_start": [0, 2, 5],
        "scan_index": [3, 7, 0, 1, 2],
        "timestamp_s": np.arange(5.0),
        "poses": straight_poses(5),
    }
    return Trajectory(**{**parts, **changes})


def with_row(row):
    poses = straight_poses(5)
    poses[2] = row
    return poses


@pytest.mark.parametrize(
    ("wrong", "said"),
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
        ({"timestamp_s": [0, 1, np.inf, 3, 4]}, "timestamp_s holds infinite"),
        ({"poses": straight_poses(4)}, r"poses has shape \(4, 7\), wanted \(5, 7\)"),
        ({"poses": with_row([1, 2, 3, 0, 0, 0, 0])}, "pose of row 2"),
        ({"poses": with_row([np.nan, 2, 3, 0, 0, 0, 1])}, "pose of row 2"),
        ({"poses": with_row([np.inf, 2, 3, 0, 0, 0, 1])}, "pose of row 2"),
    ],
)
def test_a_trajectory_that_cannot_be_is_refused(wrong, said):
    with pytest.raises(InvalidMap, match=said):
        trajectory(**wrong)


def test_a_trajectory_needs_a_scan():
    with pytest.raises(EmptyDrive):
        Trajectory((), [0], [], [], np.empty((0, 7)))  # type: ignore[arg-type]
    with pytest.raises(EmptyDrive, match="no drive to map"):
        Trajectory.concatenate([])


def test_a_trajectory_tells_the_drive_of_each_scan():
    assert trajectory().drive_of_scan.tolist() == [0, 0, 1, 1, 1]
    assert len(trajectory()) == 5
    assert trajectory(poses=with_row([np.nan] * 7)).known.tolist() == [
        True,
        True,
        False,
        True,
        True,
    ]


def test_trajectories_one_after_another_keep_drives_apart():
    joined = Trajectory.concatenate([trajectory(), trajectory(drives=("c", "d"))])
    assert joined.drives == ("a", "b", "c", "d")
    assert joined.drive_start.tolist() == [0, 2, 5, 7, 10]
    assert joined.scan_index.tolist() == [3, 7, 0, 1, 2] * 2
    assert joined.drive_of_scan.tolist() == [0, 0, 1, 1, 1, 2, 2, 3, 3, 3]


def test_a_selection_leaves_out_drives_left_empty():
    chosen = trajectory().select(np.array([2, 4]))
    assert chosen.drives == ("b",)
    assert chosen.drive_start.tolist() == [0, 2]
    assert chosen.scan_index.tolist() == [0, 2]
    assert chosen.poses[:, 0].tolist() == [2.0, 4.0]


# Topology


def test_nodes_stand_where_segments_meet_and_at_a_drives_last_scan():
    graph = Topology.of_segments(trajectory(), np.array([0, 2, 4, 5]))
    assert graph.node_scan.tolist() == [0, 1, 2, 4, 4]
    assert graph.edge_nodes.tolist() == [[0, 1], [2, 3], [3, 4]]
    assert graph.edge_length_m.tolist() == [1.0, 2.0, 0.0]
    assert graph.edge_scans.tolist() == [1, 2, 0]


def test_without_poses_no_edge_has_a_length():
    unknown = trajectory(poses=np.full((5, 7), np.nan))
    lengths_m = Topology.of_segments(unknown, np.array([0, 2, 4, 5])).edge_length_m
    assert np.isnan(lengths_m).all()


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        (([0, 4], [[0, 2]], [1.0]), "names a node that does not exist"),
        (([0, 4], [[-1, 1]], [1.0]), "names a node that does not exist"),
        (([0, 4], [[0, 1, 1]], [1.0]), r"edge_nodes has shape \(1, 3\), wanted \(1, 2\)"),
        (([[0, 4]], [[0, 0]], [1.0]), "node_scan has shape"),
        (([0, 4], [[0, 1]], [[1.0, 2.0]]), "edge_length_m has shape"),
        (([0, 4], [[0, 1]], [-1.0]), "negative"),
        (([0, 4], [[0, 1]], [np.inf]), "infinite"),
    ],
)
def test_a_graph_that_cannot_be_is_refused(parts, said):
    with pytest.raises(InvalidMap, match=said):
        Topology(*parts)
