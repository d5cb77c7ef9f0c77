"""Folders of recorded scans: KITTI's layout, Ford's, and none."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from core.errors import EmptyDrive, InvalidScan
from storage.formats.drives.ford_drive import open_ford_drive
from storage.formats.drives.kitti_drive import write_kitti_drive
from storage.formats.drives.layouts import open_drive
from storage.formats.errors import (
    MalformedDrive,
    MalformedScan,
    TruncatedScan,
    UnknownDriveLayout,
)
from storage.formats.scans.registry import read_scan_file
from tests.support import scan_files
from tests.support.samples import sample_points

IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0"
# Lidar x forward, y left, z up to camera x right, y down, z forward; the camera sits 0.3 m ahead
# of the lidar and 0.1 m below it, so that a lidar point p is (-y, -z - 0.1, x - 0.3) to the camera.
TR = "0 -1 0 0 0 0 -1 -0.1 1 0 0 -0.3"


def kitti(folder: Path, scans: int = 3, **texts: str) -> Path:
    (folder / "velodyne").mkdir(parents=True)
    for index in range(scans):
        row = np.array([[10.0 + index, 1.0, -1.0, 0.5]], "<f4")
        (folder / "velodyne" / f"{index:06d}.bin").write_bytes(row.tobytes())
    for name, text in texts.items():
        (folder / f"{name}.txt").write_text(text)
    return folder


def ford(folder: Path, **fields: object) -> Path:
    (folder / "SCANS").mkdir(parents=True)
    for number in (9, 10, 100):
        scan = {
            "XYZ": np.array([[float(number)], [2.0], [3.0]]),
            "X_wv": np.array([[1.0], [2.0], [3.0], [0.0], [0.0], [0.0]]),
            "timestamp_laser": number * 1e6 + 500_000,
        } | fields
        savemat(folder / "SCANS" / f"Scan{number}.mat", {"SCAN": scan})
    return folder


class TestKitti:
    def test_a_drive_without_times_and_poses_has_none(self, tmp_path: Path) -> None:
        drive = open_drive(kitti(tmp_path / "town"))
        assert (drive.name, len(drive)) == ("town", 3)
        assert np.isnan(drive.timestamp_s).all()
        assert np.isnan(drive.poses).all()
        assert drive.scan(2).points_m[0, 0] == 12.0
        assert drive.scan(2).pose is None

    def test_poses_without_a_calibration_are_the_lidars(self, tmp_path: Path) -> None:
        poses = f"{IDENTITY}\n{' '.join(['nan'] * 12)}\n0 -1 0 5 1 0 0 6 0 0 1 7\n\n"
        drive = open_drive(kitti(tmp_path / "a", poses=poses, times="0\n0.1\n2e-1\n"))
        assert drive.timestamp_s.tolist() == [0.0, 0.1, 0.2]
        pose = drive.scan(2).pose
        assert pose is not None
        assert (pose.x_m, pose.y_m, pose.z_m, round(pose.yaw_deg, 9)) == (5.0, 6.0, 7.0, 90.0)
        assert drive.scan(1).pose is None

    def test_camera_poses_become_the_lidars_in_a_world_with_z_up(self, tmp_path: Path) -> None:
        # By hand. Scan 1: the camera is 4 m further along its z and 1 m along its x, not rotated;
        # the lidar therefore 4 m forward and 1 m right. Scan 2: camera at the origin, rotated left
        # by 90 degrees, about -y: its z looks along -x of the world. The lidar sits 0.3 m behind
        # the camera, so from (0, 0) it goes to (0.3, -0.3): the camera stays at (0.3, 0).
        poses = f"{IDENTITY}\n1 0 0 1 0 1 0 0 0 0 1 4\n0 0 -1 0 0 1 0 0 1 0 0 0\n"
        drive = open_drive(kitti(tmp_path / "a", poses=poses, calib=f"P0: 1 2\nTr: {TR}\n"))
        np.testing.assert_allclose(drive.poses[0], [0, 0, 0, 0, 0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(drive.poses[1], [4, -1, 0, 0, 0, 0, 1], atol=1e-12)
        half = np.sqrt(0.5)
        np.testing.assert_allclose(drive.poses[2], [0.3, -0.3, 0, 0, 0, half, half], atol=1e-12)

    @pytest.mark.parametrize(
        ("texts", "message"),
        [
            ({"times": "0\n1\n"}, r"times.txt ends at line 2, the drive has 3 scans"),
            ({"times": "0\n1\n2\n3\n"}, r"times.txt ends at line 4, the drive has 3 scans"),
            ({"times": "0\none\n2\n"}, r"times.txt, line 2: .*one"),
            ({"times": "0\n\n2\n"}, r"times.txt, line 2: 0 values, wanted 1"),
            ({"poses": f"{IDENTITY}\n" * 2}, r"poses.txt ends at line 2"),
            ({"poses": f"{IDENTITY}\n{IDENTITY} 1\n{IDENTITY}"}, r"line 2: 13 values, wanted 12"),
            ({"poses": f"{IDENTITY}\n{IDENTITY}\n" + "2 " * 12}, r"poses.txt, line 3: .*rotation"),
            (
                {"poses": f"{IDENTITY}\n" * 3, "calib": "Tr: 1 2\n"},
                r"calib.txt, line 1: 2 values, wanted 12",
            ),
            ({"poses": f"{IDENTITY}\n" * 3, "calib": "P0: 1\n"}, r"calib.txt has no line 'Tr:'"),
            (
                {"poses": f"{IDENTITY}\n" * 3, "calib": "\nTr: " + "2 " * 12},
                r"calib.txt, line 2: .*rotation",
            ),
        ],
    )
    def test_a_file_that_does_not_fit_is_named_with_its_line(
        self, tmp_path: Path, texts: dict[str, str], message: str
    ) -> None:
        with pytest.raises(MalformedDrive, match=rf"/a: .*{message}"):
            open_drive(kitti(tmp_path / "a", 3, **texts))

    def test_a_layout_without_scans_is_an_empty_drive(self, tmp_path: Path) -> None:
        with pytest.raises(EmptyDrive, match=r"/a/velodyne has no scan files \*\.bin$"):
            open_drive(kitti(tmp_path / "a", scans=0))

    def test_scans_of_another_format_in_its_folder_are_named(self, tmp_path: Path) -> None:
        folder = kitti(tmp_path / "a", scans=0)
        (folder / "velodyne" / "000000.pcd").touch()
        message = r"velodyne has no scan files \*\.bin; scan files are in /.*/a/velodyne: name"
        with pytest.raises(EmptyDrive, match=message):
            open_drive(folder)


class TestFord:
    def test_scans_come_in_the_order_of_their_numbers_and_unturned(self, tmp_path: Path) -> None:
        drive = open_drive(ford(tmp_path / "campus"))
        assert (drive.name, len(drive)) == ("campus", 3)
        assert [drive.scan(i).points_m[0].tolist() for i in range(3)] == [
            [9.0, 2.0, 3.0],
            [10.0, 2.0, 3.0],
            [100.0, 2.0, 3.0],
        ]
        assert drive.timestamp_s.tolist() == [9.5, 10.5, 100.5]
        assert drive.scan(1).timestamp_s == 10.5

    def test_the_pose_of_a_truck_heading_north_is_the_lasers_in_a_world_with_z_up(
        self, tmp_path: Path
    ) -> None:
        # By hand: 2.4 m ahead (north), 0.01 m left (west) and 2.3 m above the truck, whose origin
        # is 1 north, 2 east and 3 down; the laser's x axis looks right, to the east.
        pose = open_drive(ford(tmp_path / "a")).scan(0).pose
        assert pose is not None
        np.testing.assert_allclose(pose.as_tuple()[:3], [3.4, -1.99, -0.7], atol=1e-9)
        assert pose.yaw_deg == pytest.approx(-90.0)

    def test_a_heading_east_turns_the_pose_clockwise(self, tmp_path: Path) -> None:
        x_wv = np.array([[0.0], [0.0], [0.0], [0.0], [0.0], [np.pi / 2]])
        drive = open_drive(ford(tmp_path / "a", X_wv=x_wv))
        np.testing.assert_allclose(drive.poses[0, :3], [0.01, -2.4, 2.3], atol=1e-9)
        pose = drive.scan(0).pose
        assert pose is not None
        assert abs(pose.yaw_deg) == pytest.approx(180.0)  # the laser's x axis looks south

    def test_a_truck_that_noses_up_sees_ahead_above(self, tmp_path: Path) -> None:
        # Pitch 30 degrees lifts the nose. The laser's y looks ahead: up by sin 30 in the world.
        x_wv = np.array([[0.0], [0.0], [0.0], [0.0], [np.pi / 6], [0.0]])
        pose = open_drive(ford(tmp_path / "a", X_wv=x_wv)).scan(0).pose
        assert pose is not None
        x, y, z, w = pose.qx, pose.qy, pose.qz, pose.qw
        ahead = [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)]
        np.testing.assert_allclose(ahead, [np.cos(np.pi / 6), 0, 0.5], atol=1e-9)

    def test_a_pose_that_is_not_finite_is_unknown(self, tmp_path: Path) -> None:
        drive = open_drive(ford(tmp_path / "a", X_wv=np.full((6, 1), np.nan)))
        assert np.isnan(drive.poses).all()
        assert drive.scan(0).pose is None

    @pytest.mark.parametrize(
        "fields",
        [
            {"XYZ": np.zeros((4, 5))},
            {"XYZ": "text"},
            {"X_wv": np.zeros(5)},
            {"X_wv": "text"},
            {"X_wv": np.array([1e300, 0.0, 0.0, 0.0, 0.0, 0.0])},
            {"timestamp_laser": 1e300},
            {"timestamp_laser": np.inf},
        ],
    )
    def test_a_struct_of_another_shape_or_size_is_malformed_and_names_the_file(
        self, tmp_path: Path, fields: dict[str, object]
    ) -> None:
        drive = open_drive(ford(tmp_path / "a", **fields))
        with pytest.raises(MalformedScan, match=r"Scan9\.mat"):
            drive.scan(0)
        assert np.isnan(drive.poses).all()
        assert np.isnan(drive.timestamp_s).all()

    def test_a_damaged_file_leaves_the_rest_of_the_drive_whole(self, tmp_path: Path) -> None:
        folder = ford(tmp_path / "campus")
        files = sorted((folder / "SCANS").iterdir())
        files[1].write_bytes(files[1].read_bytes()[:200])
        drive = open_ford_drive(folder)
        assert np.isfinite(drive.poses[0]).all()
        damaged = [i for i in range(len(drive)) if np.isnan(drive.poses[i]).all()]
        assert len(damaged) == 1
        with pytest.raises(TruncatedScan, match=files[1].name):
            drive.scan(damaged[0])

    def test_a_file_cut_anywhere_is_no_scan(self, tmp_path: Path) -> None:
        drive = open_drive(ford(tmp_path / "a"))
        file = tmp_path / "a" / "SCANS" / "Scan9.mat"
        whole = file.read_bytes()
        for length in range(0, len(whole), 16):
            file.write_bytes(whole[:length])
            with pytest.raises(InvalidScan, match=r"Scan9\.mat"):
                drive.scan(0)


class TestFolder:
    def test_scan_files_are_taken_by_name_their_numbers_by_value(self, tmp_path: Path) -> None:
        for number in (10, 9, 1):
            np.save(tmp_path / f"{number}.npy", np.array([[float(number), 0.0, 0.0]]))
        (tmp_path / "notes.txt").write_text("rain")
        (tmp_path / "._1.npy").write_bytes(b"")
        (tmp_path / "5.las").mkdir()
        drive = open_drive(tmp_path)
        assert drive.name == tmp_path.name
        assert [float(drive.scan(i).points_m[0, 0]) for i in range(len(drive))] == [1, 9, 10]
        assert drive.poses.shape == (3, 7)

    def test_scans_are_read_on_demand(self, tmp_path: Path) -> None:
        (tmp_path / "0.npy").write_bytes(b"no array")
        drive = open_drive(tmp_path)
        with pytest.raises(MalformedScan, match=r"0\.npy"):
            drive.scan(0)

    def test_times_and_poses_beside_the_scans_are_read_as_those_of_kitti(
        self, tmp_path: Path
    ) -> None:
        for number in (10, 9):
            np.save(tmp_path / f"{number}.npy", np.array([[float(number), 0.0, 0.0]]))
        (tmp_path / "times.txt").write_text("5.5\n6.5\n")
        (tmp_path / "poses.txt").write_text(f"{IDENTITY}\n1 0 0 3 0 1 0 4 0 0 1 0\n")
        drive = open_drive(tmp_path)
        assert drive.timestamp_s.tolist() == [5.5, 6.5]
        assert drive.poses[:, :2].tolist() == [[0.0, 0.0], [3.0, 4.0]]
        (tmp_path / "poses.txt").write_text("5.5 3 4 0 0 0 0 1\n" * 2)
        with pytest.raises(
            MalformedDrive, match=r"poses.txt, line 1: 8 values, TUM.s .* wanted KITTI.s 12"
        ):
            open_drive(tmp_path)

    def test_the_error_for_a_folder_of_folders_names_those_with_scans(self, tmp_path: Path) -> None:
        for folder in ("drive/front", "drive/left", "drive/logs/data", "drive/empty"):
            (tmp_path / folder).mkdir(parents=True)
        for scan in ("front/0.pcd", "left/0.pcd", "logs/data/0.bin"):
            (tmp_path / "drive" / scan).touch()
        message = r"; scan files are in .*/front, .*/left, .*/logs/data: name one of these folders$"
        with pytest.raises(UnknownDriveLayout, match=message):
            open_drive(tmp_path / "drive")

    def test_the_error_for_an_unknown_folder_lists_the_expected_files(self, tmp_path: Path) -> None:
        (tmp_path / "a.xyz").write_text("1 2 3")
        for path in (tmp_path, tmp_path / "absent", tmp_path / "a.xyz"):
            with pytest.raises(UnknownDriveLayout, match=r"velodyne/.*SCANS/.*\.npy"):
                open_drive(path)
        with pytest.raises(UnknownDriveLayout, match=r"^there is no .*/absent; wanted a folder"):
            open_drive(tmp_path / "absent")


class TestFilesNamedByTimes:
    @staticmethod
    def folder(path: Path, *names: str) -> Path:
        for index, name in enumerate(names):
            (path / name).write_bytes(scan_files.npy(sample_points(index)))
        return path

    def test_they_are_in_order_of_time_and_keep_it(self, tmp_path: Path) -> None:
        drive = open_drive(self.folder(tmp_path, "9.45.npy", "9.5.npy", "10.000001.npy", "9.0.npy"))
        assert drive.timestamp_s.tolist() == [9.0, 9.45, 9.5, 10.000001]
        np.testing.assert_array_equal(drive.scan(1).points_m, sample_points(0))
        assert drive.scan(1).timestamp_s == 9.45

    @pytest.mark.parametrize(
        "fractions", [("05", "1", "15", "2"), ("5000000", "105000000", "205000000")]
    )
    def test_behind_other_text_they_are_in_order_of_time_too(
        self, tmp_path: Path, fractions: tuple[str, ...]
    ) -> None:
        names = (f"at_1679000000.{fraction}.npy" for fraction in fractions)
        drive = open_drive(self.folder(tmp_path, *names))
        for index in range(len(fractions)):
            np.testing.assert_array_equal(drive.scan(index).points_m, sample_points(index))

    def test_a_fraction_that_begins_with_zero_shows_that_shorter_ones_are_decimals(
        self, tmp_path: Path
    ) -> None:
        drive = open_drive(self.folder(tmp_path, "9.123456789.npy", "9.5.npy", "9.012345678.npy"))
        assert drive.timestamp_s.tolist() == [9.012345678, 9.123456789, 9.5]

    def test_those_of_kitti_have_the_times_of_times_txt_where_there_is_one(
        self, tmp_path: Path
    ) -> None:
        (tmp_path / "velodyne").mkdir()
        for name in ("1.50.bin", "1.5000001.bin"):
            (tmp_path / "velodyne" / name).write_bytes(scan_files.kitti(sample_points(0)))
        assert open_drive(tmp_path).timestamp_s.tolist() == [1.5, 1.5000001]
        (tmp_path / "times.txt").write_text("7\n8\n")
        assert open_drive(tmp_path).timestamp_s.tolist() == [7.0, 8.0]

    @pytest.mark.parametrize(
        ("names", "message"),
        [
            (["1.5.npy", "000002.npy"], "1.5.npy is named by a time, 000002.npy is not"),
            (["1.5.npy", "1.50.npy"], "1.5.npy and 1.50.npy are the same time"),
            (["1.bin", "0.npy", "1.npy"], "has a scan twice, as 1.bin and 1.npy: wanted one"),
            (["7.npy", "7.pcd.bin"], "has a scan twice, as 7.npy and 7.pcd.bin"),
            (
                ["9.100000000.npy", "9.5000000.npy"],
                "9.5000000.npy and 9.100000000.npy may be named by nanoseconds without leading",
            ),
        ],
    )
    def test_mixed_and_colliding_names_are_an_error_with_both(
        self, tmp_path: Path, names: list[str], message: str
    ) -> None:
        with pytest.raises(MalformedDrive, match=re.escape(message)):
            open_drive(self.folder(tmp_path, *names))


def test_a_drive_is_opened_by_text_as_by_a_path_and_shown_without_its_files(tmp_path) -> None:
    folder = kitti(tmp_path / "monday", poses="\n".join([IDENTITY] * 3))
    opened = open_drive(str(folder))
    assert np.array_equal(opened.poses, open_drive(folder).poses)
    assert repr(opened) == "FileDrive(name='monday', scans=3, posed=3)"
    assert (
        read_scan_file(str(folder / "velodyne" / "000000.bin"), min_returns=1).points_m[0, 0] == 10
    )
    write_kitti_drive(opened, str(tmp_path / "again"))
    assert len(open_drive(tmp_path / "again")) == 3
