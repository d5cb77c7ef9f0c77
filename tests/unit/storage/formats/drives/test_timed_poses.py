"""Poses at the times of scans, interpolated."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from storage.formats.drives.timed_poses import TimedPoses, read_timed_poses, timed_poses
from storage.formats.errors import MalformedDrive


def row(x_m: float, yaw_deg: float = 0.0) -> list[float]:
    return [x_m, 2.0, 3.0, *Rotation.from_euler("z", yaw_deg, degrees=True).as_quat()]


def poses(*at_s: float, **of: float) -> TimedPoses:
    return TimedPoses("gt.csv", np.array(at_s), np.array([row(10.0 * s, 30.0 * s) for s in at_s]))


def test_a_pose_between_two_is_interpolated_along_the_line_and_the_arc() -> None:
    found = poses(0.0, 1.0).at(np.array([0.0, 0.25, 1.0]))
    np.testing.assert_allclose(found, [row(0.0), row(2.5, 7.5), row(10.0, 30.0)], atol=1e-12)


def test_the_arc_is_the_shorter_one() -> None:
    turn = TimedPoses("gt.csv", np.array([0.0, 1.0]), np.array([row(0.0, 170.0), row(0.0, -170.0)]))
    found = turn.at(np.array([0.5]))[0]
    assert abs(Rotation.from_quat(found[3:]).as_euler("zyx", degrees=True)[0]) == pytest.approx(180)


def test_one_rotation_has_one_quaternion_also_where_the_file_has_its_negative() -> None:
    rows = np.array([row(0.0, 30.0), row(1.0, 30.0)])
    rows[:, 3:] *= -1.0
    found = TimedPoses("gt.csv", np.array([0.0, 1.0]), rows).at(np.array([0.5]))
    np.testing.assert_allclose(found, [row(0.5, 30.0)], atol=1e-12)


def test_before_after_and_in_a_gap_a_pose_is_unknown() -> None:
    found = poses(0.0, 0.5, 2.0, 2.5).at(np.array([-0.01, 0.5, 1.0, 2.0, 2.25, 2.51]))
    assert np.isnan(found).all(axis=1).tolist() == [True, False, True, False, False, True]


def test_one_pose_is_known_at_its_time() -> None:
    found = poses(5.0).at(np.array([4.9, 5.0]))
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1], row(50.0, 150.0))


def test_poses_of_another_drive_are_refused_with_both_times() -> None:
    with pytest.raises(MalformedDrive, match=r"gt\.csv has poses from 0\.000 s to 1\.000 s, the"
                       r" scans are from 7\.000 s to 8\.000 s: none is between"):  # fmt: skip
        poses(0.0, 1.0).at(np.array([7.0, 8.0]))


def test_lines_are_sorted_by_time_and_those_with_nan_or_a_time_again_left_out(
    tmp_path: Path,
) -> None:
    file = tmp_path / "gt.csv"
    file.write_text("3000,3, 3\n1000,1,1\n2000,nan,2\n3000,4,4\n4000,nan,0\n4000,5,5\n\n")
    time_s, numbers = read_timed_poses(file, columns=3, ticks_per_s=1e3, separator=",")
    assert time_s.tolist() == [1.0, 3.0, 4.0]
    assert numbers.tolist() == [[1.0, 1.0], [3.0, 3.0], [5.0, 5.0]]


def test_an_empty_value_of_a_csv_is_unknown_and_moves_no_other(tmp_path: Path) -> None:
    file = tmp_path / "gt.csv"
    file.write_text("1000,1,1\n2000,,2\n3000,3,\n,4,4\n5000,5,5,\n")
    time_s, numbers = read_timed_poses(file, columns=3, ticks_per_s=1e3, separator=",")
    assert (time_s.tolist(), numbers.tolist()) == ([1.0, 5.0], [[1.0, 1.0], [5.0, 5.0]])
    file.write_text("1000,1,,1\n")
    with pytest.raises(MalformedDrive, match=r"gt\.csv, line 1: 4 values, wanted 3: '1000,1,,1'"):
        read_timed_poses(file, columns=3, ticks_per_s=1e3, separator=",")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n4 5\n", "gt.csv, line 2: 2 values, wanted 3: '4 5'"),
        ("1 2 x\n", "gt.csv, line 1: .*'x'"),
    ],
)
def test_a_line_that_does_not_parse_is_named(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "gt.csv"
    file.write_text(text)
    with pytest.raises(MalformedDrive, match=message):
        read_timed_poses(file, columns=3, ticks_per_s=1.0)


def test_no_pose_at_all_and_no_rotation_are_refused() -> None:
    with pytest.raises(MalformedDrive, match=r"gt\.csv has no pose"):
        timed_poses(Path("gt.csv"), np.empty(0), np.empty((0, 4, 4)))
    with pytest.raises(MalformedDrive, match=r"gt\.csv: a pose matrix is no rotation"):
        timed_poses(Path("gt.csv"), np.zeros(1), 2.0 * np.eye(4)[None])
