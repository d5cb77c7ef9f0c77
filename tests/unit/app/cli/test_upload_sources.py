"""What is sent of each layout is what its reader reads."""

import json
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from tensormap_client import CaptureFiles, Source, UnusableScan

from app.cli.upload_sources import FilesSource, open_source
from storage.formats.drives.kitti_drive import write_kitti_drive
from storage.formats.drives.layouts import open_drive
from storage.formats.errors import MalformedDrive, UnknownFormat
from storage.formats.scans.ouster import OusterFormat
from tests.support import scan_files
from tests.support.bags import DRIVE, cloud, record_bag
from tests.support.captures import hdl32, ouster, ouster_metadata, pcap, udp
from tests.support.samples import sample_drive, sample_points


def test_a_bag_of_several_topics_is_refused_before_it_is_sent(tmp_path, monkeypatch):
    bag = record_bag(tmp_path / "two", [cloud(DRIVE[0])], topics=("/front", "/rear"))
    with pytest.raises(MalformedDrive, match=r"/rear \(1\); wanted .* as 'BAG#/front'"):
        open_source(bag)
    with pytest.raises(MalformedDrive, match="wanted topic /left"):
        open_source(Path(f"{bag}#/left"))
    assert isinstance(open_source(Path(f"{bag}#/rear")), CaptureFiles)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    assert isinstance(open_source(bag), CaptureFiles)  # the service reads it


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


def scans_of(path: Path, format_name: str | None = None) -> Source:
    opened = open_source(path, format_name)
    assert not isinstance(opened, CaptureFiles)
    return opened


@pytest.mark.parametrize(
    "write",
    [kitti, mulran, helipr, nclt, ford, clouds, ousters],
)
def test_the_service_reads_of_each_layout_what_the_commands_read(tmp_path, write) -> None:
    path = write(tmp_path)
    drive, source = open_drive(path), scans_of(path)
    assert (source.name, len(source)) == (drive.name, len(drive))
    for index in range(len(drive)):
        sent, read = source.scan_body(index), drive.scan(index)
        assert sent.returns_m is not None
        np.testing.assert_array_equal(sent.returns_m(), read.points_m)
        pose = None if read.pose is None else read.pose.as_tuple()
        assert (sent.index, sent.pose) == (index, pose)
        time_s = np.nan if sent.timestamp_s is None else sent.timestamp_s
        np.testing.assert_equal(time_s, read.timestamp_s)


def test_scan_files_are_sent_unparsed(tmp_path) -> None:
    source = scans_of(kitti(tmp_path))
    file = tmp_path / "monday" / "velodyne" / "000001.bin"
    file.write_bytes(b"no scan at all")
    assert source.scan_body(1).body == b"no scan at all"


def test_a_capture_of_an_ouster_is_sent_after_its_metadata(tmp_path) -> None:
    sent = scans_of(ousters(tmp_path)).scan_body(0)
    assert sent.media_type == OusterFormat().media_type
    assert sent.body.startswith(b"{")


def test_records_in_bin_may_be_of_a_named_format(tmp_path) -> None:
    (tmp_path / "0.bin").write_bytes(scan_files.nuscenes(sample_points(0)))
    sent = scans_of(tmp_path, "nuscenes").scan_body(0)
    assert sent.returns_m is not None
    np.testing.assert_array_equal(sent.returns_m(), sample_points(0))
    with pytest.raises(UnknownFormat, match="leave --format out"):
        open_source(velodyne(tmp_path), "kitti")


def test_captures_and_bags_are_sent_as_files(tmp_path) -> None:
    path = velodyne(tmp_path)
    assert open_source(path) == CaptureFiles((path,), (path.stat().st_size,))
    bag = record_bag(tmp_path / "tuesday", [cloud(points) for points in DRIVE])
    found = open_source(Path(f"{bag}#/points"))
    assert isinstance(found, CaptureFiles)
    assert [file.name for file in found.files] == ["metadata.yaml", "tuesday.mcap"]
    assert found.topic == "/points"


def test_a_file_without_returns_is_an_error_of_its_scan(tmp_path) -> None:
    (tmp_path / "SCANS").mkdir()
    (tmp_path / "SCANS" / "Scan1.mat").write_bytes(b"no matrix")
    with pytest.raises(UnusableScan):
        scans_of(tmp_path).scan_body(0)


def test_missing_scan_files_are_noted_unless_the_scans_have_times(tmp_path: Path) -> None:
    write_kitti_drive(sample_drive(12), tmp_path / "monday")
    for name in ("poses.txt", "times.txt"):
        (tmp_path / "monday" / name).unlink()
    assert source_of(tmp_path).notes == ()
    for number in (5, 6, 7):
        (tmp_path / "monday" / "velodyne" / f"{number:06d}.bin").unlink()
    [note] = source_of(tmp_path).notes
    assert note.startswith("scan files 5 to 7 are missing, ")
    timed = tmp_path / "timed"
    named_by_time(timed / "sensor_data" / "Ouster", 1)
    assert open_source(timed).notes == ()  # type: ignore[union-attr]  # of files


def source_of(folder: Path) -> FilesSource:
    source = open_source(folder / "monday")
    assert isinstance(source, FilesSource)
    return source
