"""A drive written in KITTI's layout is the same drive when it is opened."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli.main import cli
from core.errors import InvalidScan
from core.scans.drive import MemoryDrive
from core.scans.pose import Pose
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from storage.formats.drives.kitti_drive import write_kitti_drive
from storage.formats.drives.layouts import open_drive
from storage.formats.errors import MalformedDrive


def test_scans_times_and_poses_come_back_as_they_were(tmp_path: Path) -> None:
    drive = SimulatedDrive(seed=3, scans=6, lateral_offset_m=1.5)
    write_kitti_drive(drive, tmp_path / "town")
    again = open_drive(tmp_path / "town")
    assert (again.name, len(again)) == ("town", 6)
    assert again.timestamp_s.tolist() == drive.timestamp_s.tolist()
    np.testing.assert_allclose(again.poses, drive.poses, rtol=0, atol=1e-12)
    for index in range(6):
        np.testing.assert_array_equal(again.scan(index).points_m, drive.scan(index).points_m)


def test_what_is_unknown_stays_unknown(tmp_path: Path) -> None:
    scan = Scan.from_returns([[10.0, 0.0, 0.0]])
    known = Scan.from_returns([[11.0, 0.0, 0.0]], timestamp_s=2.5, pose=Pose(1.0, 2.0, 3.0))
    write_kitti_drive(MemoryDrive("half", [scan, known]), tmp_path / "half")
    half = open_drive(tmp_path / "half")
    assert half.scan(0).pose is None
    assert half.scan(1).pose == known.pose
    assert np.isnan(half.timestamp_s[0])
    assert half.timestamp_s[1] == 2.5
    write_kitti_drive(MemoryDrive("bare", [scan]), tmp_path / "bare")
    assert [file.name for file in (tmp_path / "bare").iterdir()] == ["velodyne"]


@pytest.mark.parametrize("file", ["times.txt", "poses.txt", "calib.txt"])
def test_a_text_file_may_begin_with_a_byte_order_mark(tmp_path: Path, file: str) -> None:
    write_kitti_drive(SimulatedDrive(scans=4), tmp_path / "town")
    (tmp_path / "town/calib.txt").write_text("Tr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n")
    plain = open_drive(tmp_path / "town")
    body = (tmp_path / "town" / file).read_bytes()
    (tmp_path / "town" / file).write_bytes(b"\xef\xbb\xbf" + body)
    marked = open_drive(tmp_path / "town")
    np.testing.assert_array_equal(marked.poses, plain.poses)
    np.testing.assert_array_equal(marked.timestamp_s, plain.timestamp_s)


def test_times_in_nanoseconds_are_refused(tmp_path: Path) -> None:
    write_kitti_drive(SimulatedDrive(scans=2), tmp_path / "town")
    (tmp_path / "town" / "times.txt").write_text("0\n1679000000000000000\n")
    with pytest.raises(MalformedDrive, match=r"time of scan 1 .* wanted seconds"):
        open_drive(tmp_path / "town")


def test_an_infinite_time_is_unknown_as_in_an_upload(tmp_path: Path) -> None:
    write_kitti_drive(SimulatedDrive(scans=3), tmp_path / "town")
    (tmp_path / "town" / "times.txt").write_text("0\ninf\n2\n")
    drive = open_drive(tmp_path / "town")
    np.testing.assert_array_equal(drive.timestamp_s, [0.0, np.nan, 2.0])
    assert np.isnan(drive.scan(1).timestamp_s)


def test_a_pose_farther_away_than_any_place_is_refused(tmp_path: Path) -> None:
    write_kitti_drive(SimulatedDrive(scans=2), tmp_path / "town")
    lines = "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1e9 0 1 0 0 0 0 1 0\n"
    (tmp_path / "town" / "poses.txt").write_text(lines)
    with pytest.raises(MalformedDrive, match=r"pose of scan 1 .*: a pose is 1e\+09 m away, wanted"):
        open_drive(tmp_path / "town")


@pytest.mark.parametrize("file", ["times.txt", "poses.txt"])
def test_lines_are_not_given_to_scans_of_other_numbers(tmp_path: Path, file: str) -> None:
    write_kitti_drive(SimulatedDrive(scans=4), tmp_path / "town")
    scans = tmp_path / "town" / "velodyne"
    (scans / "000003.bin").rename(scans / "000100.bin")
    (tmp_path / "town" / ({"times.txt", "poses.txt"} - {file}).pop()).unlink()
    message = f"{file} has a line for each of 4 scans, but scan 000002.bin is followed by 000100"
    with pytest.raises(MalformedDrive, match=message):
        open_drive(tmp_path / "town")
    (tmp_path / "town" / file).unlink()
    assert len(open_drive(tmp_path / "town")) == 4


@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("2011_09_26_drive_0001_sync/velodyne_points/data", "2011_09_26_drive_0001_sync"),
        ("2011_09_26_drive_0001_sync/image_00/data", "data"),
        ("velodyne_points", "velodyne_points"),
    ],
)
def test_a_drive_of_kittis_raw_data_is_named_by_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str, name: str
) -> None:
    scans = tmp_path / folder
    scans.mkdir(parents=True)
    (scans / "0000000000.bin").touch()
    assert open_drive(scans).name == name
    monkeypatch.chdir(scans)
    assert open_drive(".").name == name


def test_where_lines_and_scans_differ_in_number_the_missing_scan_is_named(tmp_path: Path) -> None:
    write_kitti_drive(SimulatedDrive(scans=4), tmp_path / "town")
    (tmp_path / "town" / "velodyne" / "000001.bin").unlink()
    message = (
        r"times.txt ends at line 4, the drive has 3 scans: scan 000000.bin is followed by"
        r" 000002.bin; wanted a line a scan, or no times.txt"
    )
    with pytest.raises(MalformedDrive, match=message):
        open_drive(tmp_path / "town")


def test_scans_may_have_their_suffix_in_capitals(tmp_path: Path) -> None:
    write_kitti_drive(SimulatedDrive(scans=3), tmp_path / "town")
    scans = tmp_path / "town" / "velodyne"
    for file in list(scans.iterdir()):
        file.rename(file.with_suffix(".BIN"))
    drive = open_drive(tmp_path / "town")
    assert [len(drive.scan(index)) > 0 for index in range(len(drive))] == [True] * 3


def test_a_gap_is_found_between_scans_of_nuscenes_too(tmp_path: Path) -> None:
    for number in (0, 1, 3):
        (tmp_path / f"{number:06}.pcd.bin").touch()
    (tmp_path / "times.txt").write_text("0\n1\n2\n")
    with pytest.raises(MalformedDrive, match=r"000001.pcd.bin is followed by 000003.pcd.bin"):
        open_drive(tmp_path)


@pytest.mark.parametrize("names", [[1, 2, 3], [1679000000, 1679000002, 1679000003]])
def test_scans_are_numbered_from_any_number_or_by_time(tmp_path: Path, names: list[int]) -> None:
    drive = SimulatedDrive(scans=3)
    write_kitti_drive(drive, tmp_path / "town")
    scans = tmp_path / "town" / "velodyne"
    for at in (2, 1, 0):
        (scans / f"{at:06}.bin").rename(scans / f"{names[at]:06}.bin")
    np.testing.assert_allclose(open_drive(tmp_path / "town").poses, drive.poses, atol=1e-12)


def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    drive = SimulatedDrive(scans=2)
    for taken in (tmp_path, tmp_path / "mine.txt"):
        with pytest.raises(FileExistsError, match="no empty folder"):
            write_kitti_drive(drive, taken)
    assert [file.name for file in tmp_path.iterdir()] == ["mine.txt"]


def test_a_drive_that_breaks_off_leaves_nothing(tmp_path: Path) -> None:
    class Broken(SimulatedDrive):
        def scan(self, index: int) -> Scan:
            if index == 1:
                raise InvalidScan("the disk was bumped")
            return super().scan(index)

    with pytest.raises(InvalidScan):
        write_kitti_drive(Broken(scans=2), tmp_path / "town")
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_a_drive_into_an_empty_folder(tmp_path: Path) -> None:
    out = tmp_path / "town"
    out.mkdir()
    result = CliRunner().invoke(cli, ["simulate", str(out), "--scans", "3", "--reverse"])
    assert result.exit_code == 0, result.output
    assert "3 scans of simulated-0" in result.output
    written = open_drive(out)
    np.testing.assert_allclose(written.poses, SimulatedDrive(0, 3, reverse=True).poses, atol=1e-12)
    again = CliRunner().invoke(cli, ["simulate", str(out)])
    assert isinstance(again.exception, FileExistsError)


@pytest.mark.parametrize("head", ["", "# timestamp tx ty tz qx qy qz qw\n"])
def test_poses_in_tums_form_are_named_with_the_way_to_send_them(tmp_path: Path, head: str) -> None:
    write_kitti_drive(SimulatedDrive(scans=2), tmp_path / "town")
    poses = tmp_path / "town" / "poses.txt"
    poses.write_text(f"{head}0.0 1 2 3 0 0 0 1\n0.1 2 2 3 0 0 0 1\n")
    wanted = r"8 values, TUM's .*, wanted KITTI's 12, .*application/vnd.tensormap.poses.tum"
    with pytest.raises(MalformedDrive, match=wanted):
        open_drive(tmp_path / "town")
    poses.write_text("0.1 2 2 3 0 0 0\n")
    with pytest.raises(MalformedDrive, match=r"7 values, wanted 12: "):
        open_drive(tmp_path / "town")


def test_comments_between_times_are_left_out_as_in_an_upload(tmp_path: Path) -> None:
    write_kitti_drive(SimulatedDrive(scans=3), tmp_path / "town")
    times = tmp_path / "town" / "times.txt"
    times.write_text("# seconds\n0.5\n0.6 # late\n  # of the clock\n0.7\n")
    assert open_drive(tmp_path / "town").timestamp_s.tolist() == [0.5, 0.6, 0.7]
    times.write_text("# seconds\n0.5\n0.6\n")
    message = r"times.txt ends at line 3 with 2 times, the drive has 3 scans"
    with pytest.raises(MalformedDrive, match=message):
        open_drive(tmp_path / "town")


def test_comments_between_poses_are_left_out_as_in_an_upload(tmp_path: Path) -> None:
    write_kitti_drive(SimulatedDrive(scans=3), tmp_path / "town")
    poses = tmp_path / "town" / "poses.txt"
    plain, lines = open_drive(tmp_path / "town"), poses.read_text().splitlines()
    commented = ["# odometry", lines[0], f"{lines[1]} # stop", "  # r11 r12", lines[2], "# end"]
    poses.write_text("\n".join(commented))
    np.testing.assert_array_equal(open_drive(tmp_path / "town").poses, plain.poses)
    for wrong, message in (
        ("1 2 3", "line 5: 3 values, wanted 12"),
        (" ".join(["2.0"] * 12), "line 5: "),
        (f"\n{lines[2]}", "line 5: 0 values"),
    ):
        poses.write_text("\n".join([*commented[:4], wrong]))
        with pytest.raises(MalformedDrive, match=rf"poses.txt, {message}"):
            open_drive(tmp_path / "town")
    poses.write_text("\n".join(commented[:4]))
    message = r"poses.txt ends at line 3 with 2 poses, the drive has 3 scans"
    with pytest.raises(MalformedDrive, match=message):
        open_drive(tmp_path / "town")
    poses.write_text("# nothing\n")
    with pytest.raises(MalformedDrive, match="ends at line 0, the drive has 3 scans"):
        open_drive(tmp_path / "town")
