"""Scans as users have them, one file a format."""

from pathlib import Path

import numpy as np
import pytest

from core.projection import Reducer, project_scan
from core.scan import Scan
from core.sensor import AngularGrid
from storage.formats.drives import open_drive
from storage.formats.errors import UnknownFormat, WrongDtype
from storage.formats.ford_drive import read_ford_scan
from storage.formats.registry import read_scan_file

pytestmark = pytest.mark.real_data


@pytest.fixture(scope="module")
def native(data_folder: Path) -> Path:
    folder = data_folder / "native"
    if not folder.is_dir():
        pytest.skip("recorded scans are needed: TENSORMAP_DATA has no folder native/")
    return folder


def range_image(scan: Scan) -> np.ndarray:
    return project_scan(scan, AngularGrid(), Reducer.NEAREST).ranges_m


@pytest.mark.parametrize(
    ("name", "returns"),
    [
        ("derived_kit300_ascii.pcd", 46_828),
        ("derived_kit300_kitti.bin", 46_828),
        ("icet_frame_804.npy", 65_536),
        ("kitti_n1ckfg_example001.bin", 120_610),
        ("mulran_os1_keyframe.pcd", 12_999),
        ("vlp32_padded_ring.pcd", 64_545),
    ],
)
def test_a_recorded_scan_is_read_whole(native: Path, name: str, returns: int) -> None:
    scan = read_scan_file(native / name, min_returns=1000)
    assert len(scan) + scan.dropped_returns == returns
    range_m = np.linalg.norm(scan.points_m, axis=1)
    assert 1 < np.median(range_m) < 50
    assert range_m.max() < 300
    assert range_image(scan).any()


def test_one_scan_gives_one_range_image_in_every_format(native: Path) -> None:
    kitti = read_scan_file(native / "derived_kit300_kitti.bin", min_returns=1000)
    pcd = read_scan_file(native / "derived_kit300_ascii.pcd", min_returns=1000)
    ford = read_ford_scan(native / "derived_kit300_fordlayout.mat", min_returns=1000)
    wanted = range_image(kitti)
    for scan in (pcd, ford):
        came = range_image(scan)
        np.testing.assert_array_equal(came > 0, wanted > 0)
        np.testing.assert_allclose(came, wanted, rtol=0, atol=1e-5)


def test_a_folder_in_fords_layout_opens_as_a_drive(native: Path, tmp_path: Path) -> None:
    (tmp_path / "SCANS").mkdir()
    sample = native / "derived_kit300_fordlayout.mat"
    (tmp_path / "SCANS" / "Scan0300.mat").symlink_to(sample)
    drive = open_drive(tmp_path)
    assert len(drive.scan(0)) == 46_828
    assert drive.timestamp_s[0] == pytest.approx(1_310_651_582.667050, abs=1e-5)
    assert np.isfinite(drive.poses).all()


def test_scans_of_other_records_are_not_taken_for_kitti(native: Path) -> None:
    with pytest.raises(UnknownFormat):
        read_scan_file(native / "nuscenes_LIDAR_TOP.pcd.bin", min_returns=1)
    with pytest.raises(WrongDtype):
        read_scan_file(native / "nclt_1326652795280148.bin", min_returns=1)
