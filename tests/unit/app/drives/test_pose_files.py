"""Files of poses: what is read, and which line is wrong."""

import math

import numpy as np
import pytest

from app.drives.pose_files import CSV, KITTI, TUM, read_poses
from core.errors import InvalidPose


@pytest.mark.parametrize(
    ("kind", "head", "line"),
    [
        (KITTI, b"", b"1 0 0 4 0 1 0 5 0 0 1 6\n"),
        (TUM, b"", b"1.5 1 2 3 0 0 0 1\n"),
        (CSV, b"scan,x,y,z,qx,qy,qz,qw\n", b"%d,1,2,3,0,0,0,1\n"),
    ],
)
def test_the_first_wrong_line_of_many_poses_is_named(kind: str, head: bytes, line: bytes) -> None:
    count = 60_000  # more than a block of them
    lines = [line % index if b"%" in line else line for index in range(count)]
    found = read_poses(head + b"".join(lines), kind)
    assert len(found.poses) == count
    passed_over = b"# a comment\n#\n" if kind == KITTI else b"# a comment\n\n"
    lines[50_000] = lines[55_000] = passed_over + b"1 2 three\n"
    with pytest.raises(InvalidPose, match=f"^line {50_000 + 3 + bool(head)}: "):
        read_poses(head + b"".join(lines), kind)


def test_poses_that_are_left_out_are_unknown() -> None:
    body = b"scan,x,y,z,qx,qy,qz,qw,timestamp_s\n\n7,1,2,3,0,0,0,1,\n 9 , ,,,,,,,2.5\n"
    found = read_poses(body, CSV)
    nan = math.nan
    np.testing.assert_array_equal(found.scans, [7, 9])
    np.testing.assert_array_equal(found.timestamps_s, [nan, 2.5])
    np.testing.assert_array_equal(found.poses, [[1, 2, 3, 0, 0, 0, 1], [nan] * 7])


def test_a_pose_beyond_every_frame_of_the_earth_is_rejected_in_a_file_too() -> None:
    with pytest.raises(InvalidPose, match="line 2: a pose is 1e"):
        read_poses(b"1 1 1 1 0 0 0 1\n2 1e9 1 1 0 0 0 1\n", TUM)


def test_a_time_in_nanoseconds_is_rejected_and_its_line_named() -> None:
    with pytest.raises(InvalidPose, match=r"line 2: the time is 1\.679e\+18, wanted seconds"):
        read_poses(b"1 1 1 1 0 0 0 1\n1679000000000000000 1 1 1 0 0 0 1\n", TUM)
    table = b"scan,x,y,z,qx,qy,qz,qw,timestamp_s\n7,1,2,3,0,0,0,1,1e300\n"
    with pytest.raises(InvalidPose, match=r"line 2: the time is 1e\+300, wanted seconds"):
        read_poses(table, CSV)


@pytest.mark.parametrize("lines", [b"", b"\n", b" \n\n"])
def test_a_table_without_a_line_is_rejected(lines: bytes) -> None:
    with pytest.raises(InvalidPose, match="no line with a pose"):
        read_poses(b"scan,x,y,z,qx,qy,qz,qw\n" + lines, CSV)


@pytest.mark.parametrize("between", [b"\n", b"\r\n", b" \t\n"])
def test_a_blank_line_of_kittis_is_refused_as_later_poses_would_be_of_other_scans(between) -> None:
    line = b"1 0 0 4 0 1 0 5 0 0 1 6\n"
    for before, number in ((b"", 1), (line, 2), (line + b"# a comment\n", 3)):
        with pytest.raises(InvalidPose, match=f"^line {number} is blank, wanted a line a scan"):
            read_poses(before + between + line, KITTI)
    assert len(read_poses(line + between + between, KITTI).poses) == 1


def test_poses_of_the_other_form_are_refused_with_its_media_type() -> None:
    kitti, tum = b"1 0 0 4 0 1 0 5 0 0 1 6\n", b"1.5 1 2 3 0 0 0 1\n"
    for body, kind, other in ((kitti, TUM, KITTI), (tum, KITTI, TUM)):
        with pytest.raises(InvalidPose, match=f"line 1: wanted .* {other}, with"):
            read_poses(body, kind)
