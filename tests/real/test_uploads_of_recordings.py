"""Recordings as they are, over HTTP alone: captures in parts, and folders of KITTI as a tar."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from tensormap_client import Mapper

from storage.formats.drives.layouts import open_drive
from tests.support.recording import TAR
from tests.support.service import running

pytestmark = pytest.mark.real_data


@pytest.mark.parametrize("name", ["sample_velodyne_hdl32.pcap", "sample_velodyne_vlp16_gps.pcap"])
def test_a_capture_in_parts_becomes_the_scans_that_the_commands_read(
    data_folder: Path, tmp_path: Path, name: str
) -> None:
    drive = open_drive(data_folder / "native" / name)
    with running(tmp_path / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})
        with Mapper("http://127.0.0.1", None, "campus", connections=client._transport) as mapper:
            assert mapper.upload(data_folder / "native" / name, "monday").stored == len(drive)
        for index in range(len(drive)):
            stored = client.service.store.drives.read_scan("campus", "monday", index)
            np.testing.assert_array_equal(stored.points_m, drive.scan(index).points_m)
            assert stored.timestamp_s == drive.timestamp_s[index]


def test_a_folder_of_kitti_is_taken_as_it_is(drives_folder: Path, tmp_path: Path) -> None:
    folder = drives_folder / "kitti_drive0001"
    archive = subprocess.run(
        ["tar", "c", "-C", folder, "."], check=True, capture_output=True
    ).stdout
    drive = open_drive(folder)
    with running(tmp_path / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})
        sent = client.post("/v1/maps/campus/drives/monday/scans", content=archive, headers=TAR)
        answer = sent.json()
        assert (answer["scans_stored"], answer["files_set_aside"]) == (len(drive), 0), answer
        assert answer["poses"]["set"] == len(drive)
        stored = client.service.store.drives.open("campus", "monday")
        np.testing.assert_allclose(stored.poses, drive.poses, atol=1e-12)
        np.testing.assert_array_equal(stored.timestamp_s, drive.timestamp_s)
