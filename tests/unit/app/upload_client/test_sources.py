"""What is sent of each layout is what its reader reads."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from app.upload_client.sources import open_source
from core.errors import TooFewReturns
from storage.formats.drives.kitti_drive import write_kitti_drive
from storage.formats.drives.layouts import open_drive
from storage.formats.errors import UnknownFormat
from storage.formats.scans.ouster import OusterFormat
from tests.support import scan_files
from tests.support.bags import DRIVE, cloud, record_bag
from tests.support.captures import hdl32, ouster, ouster_metadata, pcap, udp
from tests.support.samples import sample_drive, sample_points

TIME_NS = 1_561_000_444_390_857_630


def kitti(folder: Path) -> Path:
    write_kitti_drive(sample_drive(3), folder / "monday")
    return folder / "monday"


def named_by_time(scans: Path, ticks: int) -> None:
    scans.mkdir(parents=True)
    for index in range(3):
        (scans / f"{TIME_NS // ticks + index}.bin").write_bytes(
            scan_files.kitti(sample_points(index))
        )


def mulran(folder: Path) -> Path:
    named_by_time(folder / "sensor_data" / "Ouster", 1)
    return folder


def helipr(folder: Path) -> Path:
    scans = folder / "LiDAR" / "Avia"
    scans.mkdir(parents=True)
    (scans / f"{TIME_NS}.bin").write_bytes(struct.pack("<fffBBBI", 1, 2, -1, 7, 8, 3, 500) * 3)
    return folder


def nclt(folder: Path) -> Path:
    (folder / "velodyne_sync").mkdir()
    record = np.array([[20100, 19900, 20050, 7]] * 3, "<u2")
    (folder / "velodyne_sync" / f"{TIME_NS // 1000}.bin").write_bytes(record.tobytes())
    return folder


def ford(folder: Path) -> Path:
    (folder / "SCANS").mkdir()
    for number in (9, 10):
        body = scan_files.ford(sample_points(number), compress=True)
        (folder / "SCANS" / f"Scan{number}.mat").write_bytes(body)
    return folder


def clouds(folder: Path) -> Path:
    for index in (2, 10):
        (folder / f"{index}.npy").write_bytes(scan_files.npy(sample_points(index)))
    return folder


def ousters(folder: Path) -> Path:
    frames = [frame for packet in ouster() for frame in udp(packet, 7502)]
    (folder / "000.pcap").write_bytes(pcap(frames))
    (folder / "000.json").write_text(json.dumps(ouster_metadata()))
    return folder


def velodyne(folder: Path) -> Path:
    frames = [frame for payload in hdl32(turns=3.5) for frame in udp(payload, 2368)]
    (folder / "monday.pcap").write_bytes(pcap(frames))
    return folder / "monday.pcap"


def mcap(folder: Path) -> Path:
    return record_bag(folder / "monday", [cloud(points) for points in DRIVE])


def ros1(folder: Path) -> Path:
    return record_bag(folder / "monday", [cloud(points, 1) for points in DRIVE], ros=1)


@pytest.mark.parametrize(
    "write",
    [kitti, mulran, helipr, nclt, ford, clouds, ousters, velodyne, mcap, ros1],
)
def test_the_service_reads_of_each_layout_what_the_commands_read(tmp_path, write) -> None:
    path = write(tmp_path)
    drive, source = open_drive(path), open_source(path)
    assert (source.name, len(source)) == (drive.name, len(drive))
    for index in range(len(drive)):
        sent, read = source.scan_body(index), drive.scan(index)
        np.testing.assert_array_equal(sent.returns().points_m, read.points_m)
        assert (sent.index, sent.pose) == (index, read.pose)
        np.testing.assert_equal(sent.timestamp_s, read.timestamp_s)


def test_scan_files_are_sent_unparsed(tmp_path) -> None:
    source = open_source(kitti(tmp_path))
    file = tmp_path / "monday" / "velodyne" / "000001.bin"
    file.write_bytes(b"no scan at all")
    assert source.scan_body(1).body == b"no scan at all"


def test_a_capture_of_an_ouster_is_sent_after_its_metadata(tmp_path) -> None:
    sent = open_source(ousters(tmp_path)).scan_body(0)
    assert sent.media_type == OusterFormat().media_type
    assert sent.body.startswith(b"{")


def test_records_in_bin_may_be_of_a_named_format(tmp_path) -> None:
    (tmp_path / "0.bin").write_bytes(scan_files.nuscenes(sample_points(0)))
    sent = open_source(tmp_path, "nuscenes").scan_body(0)
    np.testing.assert_array_equal(sent.returns().points_m, sample_points(0))
    with pytest.raises(UnknownFormat, match="leave --format out"):
        open_source(velodyne(tmp_path), "kitti")


def test_a_cloud_without_returns_is_an_error_of_its_scan(tmp_path) -> None:
    path = record_bag(tmp_path / "monday", [cloud(np.zeros((4, 3), "<f4"))])
    with pytest.raises(TooFewReturns):
        open_source(path).scan_body(0)
