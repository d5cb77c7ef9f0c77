"""Generated folders in HeLiPR's layout, a record for each sensor."""

import struct
from pathlib import Path

import numpy as np
import pytest

from core.errors import EmptyDrive
from storage.formats.drives.layouts import open_drive
from storage.formats.errors import MalformedDrive, TruncatedScan

LAST_EARLY_NS = 1691936557946849179
RECORDS = {
    "Ouster": struct.pack("<ffffIHHH", 1.0, 2.0, -1.0, 7.0, 5, 6, 7, 8),
    "Velodyne": struct.pack("<ffffHf", 1.0, 2.0, -1.0, 7.0, 5, 0.5),
    "Avia": struct.pack("<fffBBBI", 1.0, 2.0, -1.0, 7, 8, 3, 500),
    "Aeva": struct.pack("<fffffiBf", 1.0, 2.0, -1.0, 7.0, -0.5, -500, 3, 9.0),
}
EARLY_AEVA = struct.pack("<fffffiB", 1.0, 2.0, -1.0, 7.0, -0.5, -500, 3)


def helipr(folder: Path, sensor: str, record: bytes, first_ns: int, returns: int = 3) -> Path:
    scans = folder / "LiDAR" / sensor
    scans.mkdir(parents=True)
    for index in range(2):
        (scans / f"{first_ns + index * 10**8}.bin").write_bytes(record * returns)
    return scans


@pytest.mark.parametrize("sensor", RECORDS)
def test_each_sensor_has_records_of_its_own(tmp_path: Path, sensor: str) -> None:
    scans = helipr(tmp_path / "KAIST05", sensor, RECORDS[sensor], LAST_EARLY_NS + 1)
    for path in (tmp_path / "KAIST05", scans):  # the one sensor of the sequence, or its folder
        drive = open_drive(path)
        assert (drive.name, len(drive)) == (f"KAIST05-{sensor}", 2)
        assert drive.scan(1).points_m.tolist() == [[1.0, 2.0, -1.0]] * 3
        assert np.diff(drive.timestamp_s) == pytest.approx(0.1, abs=1e-6)
        assert np.isnan(drive.poses).all()


def test_an_early_aeva_has_no_intensity(tmp_path: Path) -> None:
    scans = helipr(tmp_path / "Town01", "Aeva", EARLY_AEVA, LAST_EARLY_NS - 10**9)
    assert len(open_drive(scans).scan(0)) == 3
    later = helipr(tmp_path / "Town02", "Aeva", EARLY_AEVA, LAST_EARLY_NS + 1)
    with pytest.raises(TruncatedScan, match="29 bytes a return"):
        open_drive(later).scan(0)


def test_poses_are_the_sensors_own_between_those_of_the_file(tmp_path: Path) -> None:
    folder = tmp_path / "KAIST05"
    scans = helipr(folder, "Avia", RECORDS["Avia"], LAST_EARLY_NS + 1)
    (folder / "LiDAR_GT").mkdir()
    (folder / "LiDAR_GT" / "Avia_gt.txt").write_text(
        f"{LAST_EARLY_NS - 9 * 10**7} 0 2 3 0 0 0 1\n{LAST_EARLY_NS + 9 * 10**7} 20 2 3 0 0 1 0\n"
    )
    drive = open_drive(scans)
    np.testing.assert_allclose(drive.poses[0, :3], [10.0, 2.0, 3.0], atol=1e-3)
    pose = drive.scan(0).pose
    assert pose is not None
    assert abs(pose.yaw_deg) == pytest.approx(90.0, abs=1e-3)
    assert np.isnan(drive.poses[1]).all()


def test_a_wrong_folder_says_what_was_wanted_and_what_came(tmp_path: Path) -> None:
    folder = tmp_path / "KAIST05"
    for sensor in ("Avia", "Ouster"):
        helipr(folder, sensor, RECORDS[sensor], LAST_EARLY_NS + 1)
    with pytest.raises(MalformedDrive, match=r"has Avia, Ouster, wanted the folder of one of Avia,"
                       r" Aeva, Ouster, Velodyne, as KAIST05/LiDAR/Ouster"):  # fmt: skip
        open_drive(folder)
    (tmp_path / "none" / "LiDAR").mkdir(parents=True)
    with pytest.raises(MalformedDrive, match="has no sensor, wanted"):
        open_drive(tmp_path / "none")
    (tmp_path / "empty" / "LiDAR" / "Avia").mkdir(parents=True)
    with pytest.raises(EmptyDrive, match=r"LiDAR/Avia has no scan files \*\.bin"):
        open_drive(tmp_path / "empty")
    (folder / "LiDAR_GT").mkdir()
    (folder / "LiDAR_GT" / "Avia_gt.txt").write_text("1000000000 1 2 3 0 0 0 0\n")
    with pytest.raises(MalformedDrive, match=r"Avia_gt\.txt: the pose at 1\.000 s is .*wanted x y"):
        open_drive(folder / "LiDAR" / "Avia")
    (folder / "LiDAR_GT" / "Avia_gt.txt").write_text("1 2 3\n")
    with pytest.raises(MalformedDrive, match=r"Avia_gt\.txt, line 1: 3 values, wanted 8"):
        open_drive(folder / "LiDAR" / "Avia")


def test_records_that_are_no_metres_are_refused(tmp_path: Path) -> None:
    scans = helipr(tmp_path / "a", "Velodyne", RECORDS["Ouster"], LAST_EARLY_NS, returns=11)
    with pytest.raises(Exception, match="22 bytes a return"):
        open_drive(scans).scan(0)
