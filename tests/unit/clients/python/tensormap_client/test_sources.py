"""Recorded drives to upload."""

import pytest
from tensormap_client import FolderSource, InvalidArgument
from tensormap_client.sources import lost_numbers


def folder(path, *names):
    path.mkdir(exist_ok=True)
    for name in names:
        (path / name).write_bytes(b"")
    return path


def media_types(source):
    sent = [source.scan_body(index).media_type for index in range(len(source))]
    return [kind.removeprefix("application/vnd.tensormap.") for kind in sent]


def test_files_have_the_format_that_is_named_or_that_of_their_suffix(tmp_path):
    of_both = folder(tmp_path, "0.bin", "1.pcd.bin", "2.pcd", "3.LAZ")
    assert media_types(FolderSource(of_both)) == ["kitti", "nuscenes", "pcd", "las"]
    assert media_types(FolderSource(of_both, "helipr")) == ["helipr"] * 4
    assert media_types(FolderSource(str(of_both), "helipr")) == ["helipr"] * 4


def test_hidden_files_and_folders_are_no_scans(tmp_path):
    (tmp_path / "5.las").mkdir()
    source = FolderSource(folder(tmp_path, "._0.bin", ".1.bin", "0.bin"))
    assert [source.scan_body(index).index for index in range(len(source))] == [0]
    (tmp_path / "0.bin").unlink()
    with pytest.raises(InvalidArgument, match="has no scan file"):
        FolderSource(tmp_path)


def test_a_scan_of_nuscenes_may_be_named_by_its_time(tmp_path):
    source = FolderSource(folder(tmp_path, "1679000000.5.pcd.bin", "1679000000.25.pcd.bin"))
    assert [source.scan_body(at).timestamp_s for at in (0, 1)] == [1679000000.25, 1679000000.5]


def test_scans_named_by_date_and_time_have_times_and_no_gap_at_a_minute(tmp_path):
    names = [f"{stem}.bin" for stem in ("20230317101058", "20230317101059", "2023031710110050")]
    source = FolderSource(folder(tmp_path, *names, "poses.txt"))
    times_s = [source.scan_body(at).timestamp_s for at in range(3)]
    assert times_s == [1679047858.0, 1679047859.0, 1679047860.5]
    assert source.beside == (tmp_path / "poses.txt",)
    assert not lost_numbers(names)


def test_names_that_may_have_nanoseconds_without_leading_zeros_are_rejected(tmp_path):
    with pytest.raises(InvalidArgument, match=r"^9.5000000.pcd and 9.105000000.pcd may be named"):
        FolderSource(folder(tmp_path, "9.105000000.pcd", "9.5000000.pcd"))
    assert len(FolderSource(folder(tmp_path, "9.012345678.pcd"))) == 3  # so these are decimals


@pytest.mark.parametrize(
    "fractions", [("05", "1", "15", "2"), ("5000000", "105000000", "205000000")]
)
def test_files_named_by_text_and_a_time_are_in_order_of_time(tmp_path, fractions):
    names = [f"at_1679000000.{fraction}.npy" for fraction in fractions]
    for name in names:
        (tmp_path / name).write_text(name)
    source = FolderSource(tmp_path)
    assert [source.scan_body(at).body.decode() for at in range(len(source))] == names


def test_lines_are_not_given_to_scans_of_other_numbers(tmp_path):
    scans = folder(tmp_path / "velodyne", "000000.bin", "000001.bin", "000100.bin")
    assert len(FolderSource(tmp_path)) == 3
    folder(tmp_path, "poses.txt")
    with pytest.raises(InvalidArgument, match=r"000001.bin is followed by 000100.bin .* poses.txt"):
        FolderSource(tmp_path)
    (scans / "000100.bin").rename(scans / "000002.bin")
    assert FolderSource(tmp_path).beside == (tmp_path / "poses.txt",)


def test_times_and_poses_beside_scans_of_any_format_are_sent_too(tmp_path):
    source = FolderSource(folder(tmp_path, "0.pcd", "1.pcd", "poses.txt", "times.txt", "notes.txt"))
    assert source.beside == (tmp_path / "times.txt", tmp_path / "poses.txt")
    assert len(source) == 2


def test_missing_scan_files_whose_numbers_get_lost_are_noted(tmp_path):
    [note] = FolderSource(folder(tmp_path, *(f"{at:06d}.bin" for at in (19, 20, 40, 41)))).notes
    assert note.startswith("scan files 21 to 39 are missing, and scans are numbered from 0 without")
    assert "takes 000020.bin and 000040.bin for neighbours" in note
    assert "as a tar, which keeps their numbers" in note


@pytest.mark.parametrize(
    ("numbers", "begin"),
    [
        ([10, 20, 30, 70, 80], "scan files 40 to 60 are missing,"),
        ([*range(9), *range(20, 29), *range(40, 49)], "scan files 9 to 19 and 1 more range are"),
        ([*range(5), *range(20, 24), *range(30, 34), *range(40, 44)],
         "scan files 5 to 19 and 2 more ranges are missing,"),
    ],
)  # fmt: skip
def test_the_first_missing_range_is_named_and_others_are_counted(numbers, begin):
    [note] = lost_numbers([f"{number}.bin" for number in numbers])
    assert note.startswith(begin)


@pytest.mark.parametrize(
    "stems",
    [
        ["0", "1", "2"],
        ["7", "8", "9"],
        ["0", "1", "2", "4"],  # odometry bridges it
        ["0", "7", "15", "22", "40"],  # which step is usual?
        ["a1", "a2", "a30"],
        ["1679000000.1", "1679000000.2", "1679000009.1"],
        ["1679000000", "1679000001", "1679000002", "1679000099"],
        ["3"],
    ],
)
def test_names_that_lose_nothing_are_not_noted(stems):
    assert not lost_numbers([f"{stem}.pcd" for stem in stems])
