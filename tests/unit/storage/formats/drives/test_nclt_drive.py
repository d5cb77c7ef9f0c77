"""Generated folders in NCLT's layout."""

from pathlib import Path

import numpy as np
import pytest

from core.errors import EmptyDrive
from storage.formats.drives.layouts import open_drive
from storage.formats.errors import MalformedDrive

FIRST_US = 1326030975726043


def nclt(folder: Path, count: int = 2) -> Path:
    (folder / "velodyne_sync").mkdir(parents=True)
    for index in range(count):
        record = np.array(
            [((22000, 20000, 19800), 9, 3)], [("p", "<u2", 3), ("i", "u1"), ("l", "u1")]
        )
        (folder / "velodyne_sync" / f"{FIRST_US + index * 200_000}.bin").write_bytes(
            record.tobytes()
        )
    return folder


def truth(*rows: str) -> str:
    return "".join(f"{FIRST_US + 10_000 * number},{row}\n" for number, row in enumerate(rows, -1))


LEVEL = "1.0, 2.0, 3.0, 0.0, 0.0, 0.0"


def test_without_a_ground_truth_poses_are_unknown(tmp_path: Path) -> None:
    drive = open_drive(nclt(tmp_path / "2012-01-08"))
    assert (drive.name, len(drive)) == ("2012-01-08", 2)
    assert drive.timestamp_s.tolist() == [FIRST_US / 1e6, (FIRST_US + 200_000) / 1e6]
    assert np.isnan(drive.poses).all()


@pytest.mark.parametrize(
    "file",
    [
        "2012-01-08/groundtruth_2012-01-08.csv",
        "2012-01-08/ground_truth/groundtruth_2012-01-08.csv",
        "ground_truth/groundtruth_2012-01-08.csv",
    ],
)
def test_poses_are_the_lidars_in_a_world_with_z_up(tmp_path: Path, file: str) -> None:
    folder = nclt(tmp_path / "2012-01-08")
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text(truth("nan,nan,nan,nan,nan,nan", LEVEL, "5.0,2,3,0,0,0"))
    drive = open_drive(folder)
    # The lidar is 0.957 m above the vehicle's origin, which is 3 m below the world's and 2 m east.
    np.testing.assert_allclose(drive.poses[0], [1.002, -1.996, -2.043, 0, 0, 0, 1], atol=1e-9)
    assert np.isnan(drive.poses[1]).all()


def test_brackets_in_the_name_of_a_folder_are_of_its_name_and_no_pattern(tmp_path: Path) -> None:
    folder = nclt(tmp_path / "campus [1]")
    (tmp_path / "ground_truth").mkdir()
    file = tmp_path / "ground_truth" / "groundtruth_campus [1].csv"
    file.write_text(truth(LEVEL, LEVEL))
    assert np.isfinite(open_drive(folder).poses[0]).all()


def test_a_heading_east_turns_clockwise_and_a_raised_nose_sees_up(tmp_path: Path) -> None:
    for name, angles, ahead in (
        ("east", "0,0,1.5707963267948966", [0.0, -1.0, 0.0]),
        ("up", "0,0.5235987755982988,0", [np.cos(np.pi / 6), 0.0, 0.5]),
    ):
        folder = nclt(tmp_path / name, count=1)
        (folder / "groundtruth.csv").write_text(truth(f"0,0,0,{angles}", f"0,0,0,{angles}"))
        x, y, z, w = open_drive(folder).poses[0, 3:]
        forward = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)]
        np.testing.assert_allclose(forward, ahead, atol=1e-9)


def test_a_wrong_folder_says_what_was_wanted_and_what_came(tmp_path: Path) -> None:
    with pytest.raises(EmptyDrive):
        open_drive(nclt(tmp_path / "empty", count=0))
    twice = nclt(tmp_path / "twice")
    for name in ("groundtruth_a.csv", "groundtruth_b.csv"):
        (twice / name).write_text(truth(LEVEL))
    with pytest.raises(MalformedDrive, match=r"several ground truths, wanted one: .*_a.*_b"):
        open_drive(twice)
    short = nclt(tmp_path / "short")
    (short / "groundtruth.csv").write_text("1,2\n")
    with pytest.raises(MalformedDrive, match=r"groundtruth\.csv, line 1: 2 values, wanted 7"):
        open_drive(short)
