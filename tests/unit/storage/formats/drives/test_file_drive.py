"""Numbers that are the names of a drive's files show where some are missing."""

from pathlib import Path

import numpy as np
import pytest

from core.scans.drive import recorded_index_of, scan_index_of
from storage.formats.drives.layouts import open_drive
from storage.formats.scans.file_names import numbers_of, time_s_of
from tests.support.samples import sample_points
from tests.support.scan_files import kitti


@pytest.mark.parametrize("layout", ["velodyne", "."])
def test_a_drive_with_missing_files_counts_from_0_and_knows_their_numbers(tmp_path: Path, layout):
    folder = tmp_path / "monday" / layout
    folder.mkdir(parents=True)
    for number in (19, 20, 21, 40):
        (folder / f"{number:06d}.bin").write_bytes(kitti(sample_points(number)))
    drive = open_drive(tmp_path / "monday")
    assert scan_index_of(drive).tolist() == [0, 1, 2, 3]
    assert recorded_index_of(drive).tolist() == [19, 20, 21, 40]


@pytest.mark.parametrize(
    "stems",
    [
        ["a1", "a2", "a3"],
        ["1", "2", "b"],
        ["7"],
        ["1", "2", "5"],  # which step is usual?
        ["01", "1", "2", "3"],
        ["0", "7", "15", "22", "40"],
        ["1679000000", "1679000001", "1679000002"],
        ["20230317101058", "20230317101059", "20230317101100"],
        ["1" * 40, "2" * 40],
    ],
)
def test_other_names_are_no_numbers_of_scans(stems):
    assert numbers_of([f"{stem}.pcd" for stem in stems]) is None


def test_every_tenth_scan_is_numbered_and_so_is_a_drive_in_which_half_is_missing():
    for numbers in ([0, 10, 20, 50], [*range(10), *range(300, 310)], [4, 6]):
        found = numbers_of([f"{number}.bin" for number in numbers])
        assert found is not None
        assert found.tolist() == numbers


@pytest.mark.parametrize(
    ("stem", "time_s"),
    [
        ("20230317101059", 1679047859.0),
        ("2023031710105999", 1679047859.99),
        ("20230317101059125", 1679047859.125),
        ("20230317101059125000", 1679047859.125),
        ("19900101000000", 631152000.0),
        ("20230230101059", None),  # no such day
        ("20230317106059", None),  # no such minute
        ("19891231235959", None),
        ("202303171010591", None),
        ("1679047859990000", 1679047859.99),  # microseconds
        ("1679047859990", 1679047859.99),
        ("1679047859990000000", 1679047859.99),
        ("2042991710105999", 2042991710.105999),  # no month 99
    ],
)
def test_a_name_of_a_date_and_time_is_a_time_and_other_times_stay_theirs(
    stem: str, time_s: float | None
) -> None:
    assert time_s_of(f"{stem}.pcd") == (time_s and pytest.approx(time_s, abs=1e-6))


def test_scans_named_by_date_and_time_have_no_gap_at_a_minute_and_may_have_poses(
    tmp_path: Path,
) -> None:
    stems = ["20230317101058", "20230317101059", "20230317101100"]
    for at, stem in enumerate(stems):
        (tmp_path / f"{stem}.bin").write_bytes(kitti(sample_points(at)))
    rows = [f"1 0 0 {at} 0 1 0 0 0 0 1 0\n" for at in range(3)]
    (tmp_path / "poses.txt").write_text("".join(rows))
    drive = open_drive(tmp_path)
    assert np.diff(drive.timestamp_s).tolist() == [1.0, 1.0]
    assert drive.poses[:, 0].tolist() == [0.0, 1.0, 2.0]
    assert recorded_index_of(drive).tolist() == [0, 1, 2]
