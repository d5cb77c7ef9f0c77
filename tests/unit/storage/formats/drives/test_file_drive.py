"""Numbers that are the names of a drive's files show where some are missing."""

from pathlib import Path

import pytest

from core.scans.drive import recorded_index_of, scan_index_of
from storage.formats.drives.layouts import open_drive
from storage.formats.scans.file_names import numbers_of
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
