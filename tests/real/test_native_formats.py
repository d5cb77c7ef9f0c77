"""Scans as users have them, one file a format."""

from pathlib import Path

import numpy as np
import pytest

from core.projection.range_image import project_scan
from core.projection.reducer import Reducer
from core.scans.scan import Scan
from core.scans.sensor import AngularGrid
from storage.formats.drives.ford_drive import read_ford_scan
from storage.formats.drives.layouts import open_drive
from storage.formats.errors import TruncatedScan, UnknownFormat, WrongDtype
from storage.formats.scans.records import NcltFormat, NuscenesFormat
from storage.formats.scans.registry import read_scan, read_scan_file

pytestmark = pytest.mark.real_data


@pytest.fixture(scope="module")
def native(data_folder: Path) -> Path:
    folder = data_folder / "native"
    if not folder.is_dir():
        pytest.skip("recorded scans are needed: TENSORMAP_DATA has no folder native/")
    return folder


def range_image(scan: Scan) -> np.ndarray:
    return project_scan(scan, AngularGrid(), Reducer.NEAREST)


OF_ITS_OWN = {"nclt_1326652795280148.bin": NcltFormat().media_type}
"""Files whose suffix does not identify their format."""


@pytest.mark.parametrize(
    ("name", "returns"),
    [
        ("derived_kit300.csv", 46_828),
        ("derived_kit300.las", 46_828),
        ("derived_kit300_ascii.pcd", 46_828),
        ("derived_kit300_binary.ply", 46_828),
        ("derived_kit300_fordlayout.mat", 46_828),
        ("derived_kit300_kitti.bin", 46_828),
        ("icet_frame_804.npy", 65_536),
        ("kitti_n1ckfg_example001.bin", 120_610),
        ("libpointmatcher_car_cloud400.csv", 24_989),
        ("mulran_os1_keyframe.pcd", 12_999),
        ("nclt_1326652795280148.bin", 23_546),
        ("nuscenes_LIDAR_TOP.pcd.bin", 34_688),
        ("ouster_OS-0-32-U1_v2.2.0_1024x10.pcap", 32_768),
        ("sample_velodyne_hdl32.pcap", 76_864),
        ("sample_velodyne_vlp16_gps.pcap", 28_992),
        ("vlp32_padded_ring.pcd", 64_545),
    ],
)
def test_a_recorded_scan_is_read_whole(native: Path, name: str, returns: int) -> None:
    scan = read_scan_file(native / name, min_returns=1000, media_type=OF_ITS_OWN.get(name))
    assert len(scan) + scan.dropped_returns == returns
    range_m = np.linalg.norm(scan.points_m, axis=1)
    assert 1 < np.median(range_m) < 50
    assert range_m.max() < 300
    assert range_image(scan).any()


def test_every_file_is_read_by_the_test_above(native: Path) -> None:
    marks = test_a_recorded_scan_is_read_whole.pytestmark  # type: ignore[attr-defined]
    read = {name for mark in marks if mark.name == "parametrize" for name, _ in mark.args[1]}
    assert {file.name for file in native.iterdir() if file.suffix != ".json"} == read


def test_one_scan_gives_one_range_image_in_every_format(native: Path) -> None:
    kitti = read_scan_file(native / "derived_kit300_kitti.bin", min_returns=1000)
    expected = range_image(kitti)
    others = sorted(set(native.glob("derived_kit300*")) - {native / "derived_kit300_kitti.bin"})
    assert len(others) == 5
    scans = [read_scan_file(file, min_returns=1000) for file in others]
    scans.append(read_ford_scan(native / "derived_kit300_fordlayout.mat", min_returns=1000))
    for scan in scans:
        came = range_image(scan)
        np.testing.assert_array_equal(came > 0, expected > 0)
        # The files have millimetres.
        np.testing.assert_allclose(came, expected, rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "revolutions"),
    [("sample_velodyne_hdl32.pcap", 2), ("sample_velodyne_vlp16_gps.pcap", 3)],
)
def test_a_capture_opens_as_a_drive_of_its_revolutions(
    native: Path, name: str, revolutions: int
) -> None:
    drive = open_drive(native / name)
    assert len(drive) == revolutions
    assert np.diff(drive.timestamp_s) == pytest.approx(0.1, abs=0.02)  # 10 Hz
    first, second = (range_image(drive.scan(index)) for index in range(2))
    both = (first > 0) & (second > 0)
    assert np.median(np.abs(first - second)[both]) < 0.1  # a tenth of a second later


def test_the_ground_is_below_and_flat_where_frames_were_rotated(native: Path) -> None:
    for name in ("nclt_1326652795280148.bin", "sample_velodyne_hdl32.pcap"):
        scan = read_scan_file(native / name, min_returns=1000, media_type=OF_ITS_OWN.get(name))
        near = scan.points_m[np.hypot(*scan.points_m[:, :2].T) < 8]
        assert np.quantile(near[:, 2], 0.1) < -0.5, name
        assert np.quantile(scan.points_m[:, 2], 0.02) > -6, name


def test_a_folder_in_fords_layout_opens_as_a_drive(native: Path, tmp_path: Path) -> None:
    (tmp_path / "SCANS").mkdir()
    sample = native / "derived_kit300_fordlayout.mat"
    (tmp_path / "SCANS" / "Scan0300.mat").symlink_to(sample)
    drive = open_drive(tmp_path)
    assert len(drive.scan(0)) == 46_828
    assert drive.timestamp_s[0] == pytest.approx(1_310_651_582.667050, abs=1e-5)
    assert np.isfinite(drive.poses).all()


def test_scans_of_other_records_are_not_taken_for_kitti(native: Path) -> None:
    nuscenes = (native / "nuscenes_LIDAR_TOP.pcd.bin").read_bytes()
    kitti = (native / "derived_kit300_kitti.bin").read_bytes()
    nclt = (native / "nclt_1326652795280148.bin").read_bytes()
    for body in (nuscenes, kitti, nclt):
        with pytest.raises(UnknownFormat):
            read_scan(body, min_returns=1)
    for known in (NcltFormat(), NuscenesFormat()):
        with pytest.raises((TruncatedScan, WrongDtype)):
            read_scan(kitti, media_type=known.media_type, min_returns=1)
    with pytest.raises(WrongDtype):
        read_scan_file(native / "nclt_1326652795280148.bin", min_returns=1)
