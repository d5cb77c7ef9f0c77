"""`tensormap upload` against a service with keys: what it prints, and its errors."""

import re
from pathlib import Path

import pytest

from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from storage.formats.drives.kitti_drive import write_kitti_drive
from tests.support.access import ADMIN_KEY
from tests.support.commands import called
from tests.support.process import serving


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives") / "monday"
    sensor = SimulatedSensor(firings=180)
    write_kitti_drive(SimulatedDrive(seed=1, scans=12, stops=False, sensor=sensor), folder)
    (folder / "velodyne" / "000005.bin").write_bytes(b"no scan")
    return folder


def test_one_command_uploads_builds_and_reports(drive: Path, tmp_path: Path) -> None:
    right, wrong = tmp_path / "right", tmp_path / "wrong"
    right.write_text(f"{ADMIN_KEY}\n")
    wrong.write_text("tm_no_key\n")
    with serving(tmp_path / "data", tmp_path / "log", admin_key=ADMIN_KEY) as server:
        url = f"http://127.0.0.1:{server.port}"
        words = ("upload", drive, url, "--map", "campus", "--drive", "monday")
        key = ("--key-file", right)

        assert "--key-file names the file with one" in called(*words, status=1)
        assert "the right --key-file?" in called(*words, "--key-file", wrong, status=1)
        assert "there is no map 'campus'; --create" in called(*words, *key, status=1)

        build = ("--build", "--parameters", '{"segments": 2}')
        shown = called(*words, *key, "--create", *build)
        assert "map campus is new" in shown
        assert "monday: 11 of 12 scans stored" in shown
        assert "0 were there before, 1 skipped; 11 of 11 have a pose" in shown
        assert "skipped scan 5, 000005.bin: " in shown
        assert re.search(r"revision [0-9a-f]{64}: 11 scans in 2 segments, live", shown)
        assert re.search(r"uploading: 12 of 12, [0-9.]+ MB/s", shown)

        shown = called(*words, *key, "--build", "--parameters", '{"make_live": true}')
        assert "0 of 12 scans stored (0.0 MB), 11 were there before" in shown
        assert "self-recall " in shown

        (drive / "velodyne" / "000000.bin").write_bytes(bytes(16) * 200)
        assert "upload it as another drive" in called(*words, *key, status=1)
    assert f"{url} cannot be reached" in called(*words, *key, status=1)


def test_parameters_that_are_none_are_a_wrong_option(drive: Path) -> None:
    words = ("upload", drive, "http://127.0.0.1:9", "--map", "campus", "--drive", "monday")
    unknown = called(*words, "--build", "--parameters", '{"segmentz": 2}', status=2, COLUMNS="999")
    assert "segmentz is no field of this object, it has add, align, base, " in unknown
    no_json = called(*words, "--build", "--parameters", "{segments:3}", status=2)
    assert "'--parameters': Invalid JSON" in no_json
    assert "--build" in called(*words, "--parameters", "{}", status=2)


def test_a_folder_without_its_recording_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    words = ("upload", tmp_path, "http://127.0.0.1:9", "--map", "campus", "--drive", "monday")
    shown = called(*words, status=1)
    assert shown.startswith("tensormap: ")
    assert "has a metadata.yaml and no .db3 or .mcap" in shown
