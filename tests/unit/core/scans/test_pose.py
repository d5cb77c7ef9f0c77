"""Poses, rows and matrices of them."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.errors import InvalidPose
from core.scans.pose import (
    Pose,
    digest_of_poses,
    heading_deg,
    is_known,
    pose_rows,
    rows_from_matrices,
)


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


def test_poses_stack_into_rows():
    rows = pose_rows([Pose(1.0, 2.0, 3.0), None])
    assert rows.shape == (2, 7)
    assert is_known(rows).tolist() == [True, False]
    assert pose_rows([]).shape == (0, 7)


def test_the_digest_of_poses_is_the_one_that_catalogs_keep():
    rows = pose_rows([Pose(1.0, 2.0, 3.0)])
    assert digest_of_poses(rows) == digest_of_poses(rows.astype(">f8"))
    assert digest_of_poses(rows).startswith("7cdd6b14ca9f278d")
