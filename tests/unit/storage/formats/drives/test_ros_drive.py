"""Bags of ROS 1 and ROS 2: every kind gives the same drive."""

import sys
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from core.errors import EmptyDrive, TooFewReturns
from storage.formats.drives.layouts import open_drive
from storage.formats.errors import MalformedDrive, MalformedScan, TruncatedScan, WrongDtype

CLOUD = "sensor_msgs/msg/PointCloud2"
BEGIN_NS = 1_700_000_000_000_000_000
STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
RECORD = np.dtype(
    {
        "names": ["ring", "x", "y", "z"],
        "formats": ["<u2", "<f4", "<f4", "<f4"],
        "offsets": [0, 4, 8, 12],
        "itemsize": 22,
    }
)
DRIVE = [np.random.default_rng(seed).normal(0, 9, (40, 3)).astype("<f4") for seed in range(4)]
TIMES_NS = [BEGIN_NS, BEGIN_NS + 5, BEGIN_NS + 5, BEGIN_NS + 10**8]  # two at once


def cloud(points, ros=2, *, record=RECORD, lines=2, padding=3, **changed):
    """Return a message: points with padding, in rows with padding."""
    types = STORES[ros].types
    rows = np.zeros(len(points), record)
    for column, axis in enumerate("xyz"):
        rows[axis] = points[:, column]
    width = len(points) // lines
    data = rows.view(np.uint8).reshape(lines, width * record.itemsize)
    data = np.pad(data, ((0, 0), (0, padding)))
    stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    counted = {"seq": 0} if ros == 1 else {}
    kinds = {"f4": 7, "f8": 8, "u2": 4, "i4": 5}
    message = {
        "header": types["std_msgs/msg/Header"](stamp=stamp, frame_id="velodyne", **counted),
        "height": lines,
        "width": width,
        "fields": [
            types["sensor_msgs/msg/PointField"](
                name=name,
                offset=record.fields[name][1],
                datatype=kinds[record[name].str[1:]],
                count=1,
            )
            for name in record.names
        ],
        "is_bigendian": any(record[name].str[0] == ">" for name in record.names),
        "point_step": record.itemsize,
        "row_step": data.shape[1],
        "data": data.reshape(-1),
        "is_dense": True,
    }
    return types[CLOUD](**{**message, **changed})


def record_bag(path, messages, topics=("/points",), ros=2, plugin=StoragePlugin.MCAP):
    """Write each message to every topic; return what a user would name."""
    store = STORES[ros]
    writer: Any = Writer1(path.with_suffix(".bag"))
    if ros == 2:
        writer = Writer2(path, version=9, storage_plugin=plugin)
    with writer:
        to = [writer.add_connection(topic, CLOUD, typestore=store) for topic in topics]
        write = store.serialize_ros1 if ros == 1 else store.serialize_cdr
        for message, time_ns in zip(messages, TIMES_NS, strict=False):
            for connection in to:
                writer.write(connection, time_ns, write(message, CLOUD))
    return path.with_suffix(".bag") if ros == 1 else path


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    found = {
        "ros1": record_bag(folder / "one", [cloud(points, 1) for points in DRIVE], ros=1),
        "sqlite": record_bag(
            folder / "two", [cloud(points) for points in DRIVE], plugin=StoragePlugin.SQLITE3
        ),
        "mcap": record_bag(folder / "three", [cloud(points) for points in DRIVE]),
    }
    [found["mcap file"]] = found["mcap"].glob("*.mcap")
    [found["sqlite file"]] = found["sqlite"].glob("*.db3")
    return found


@pytest.mark.parametrize("kind", ["ros1", "sqlite", "sqlite file", "mcap", "mcap file"])
def test_each_message_of_a_bag_is_a_scan(bags, kind):
    drive = open_drive(bags[kind])
    assert drive.name == bags[kind].stem
    assert len(drive) == len(DRIVE)
    np.testing.assert_allclose(drive.timestamp_s, np.array(TIMES_NS) * 1e-9, rtol=1e-15)
    assert np.isnan(drive.poses).all()
    # In order, backwards, the same one again, and counted from the end.
    for index in (0, 1, 2, 3, 3, 2, 1, 0, 2, -1):
        scan = drive.scan(index)
        np.testing.assert_array_equal(scan.points_m, DRIVE[index])
        assert scan.timestamp_s == drive.timestamp_s[index]
    with pytest.raises(IndexError):
        drive.scan(len(DRIVE))


def test_one_of_several_topics_is_named_after_the_bag(tmp_path):
    bag = record_bag(tmp_path / "bag", [cloud(DRIVE[0])], topics=("/front", "/rear"))
    with pytest.raises(MalformedDrive, match=r"/front \(1\), /rear \(1\); wanted one topic"):
        open_drive(bag)
    assert len(open_drive(tmp_path / "bag#/rear")) == 1
    with pytest.raises(MalformedDrive, match="wanted topic /top"):
        open_drive(tmp_path / "bag#/top")


def test_a_bag_without_clouds_is_rejected(tmp_path):
    bag = record_bag(tmp_path / "bag", [], topics=())
    with pytest.raises(MalformedDrive, match="PointCloud2: none"):
        open_drive(bag)
    quiet = record_bag(tmp_path / "quiet", [])
    with pytest.raises(EmptyDrive, match="/points"):
        open_drive(quiet)


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
def test_a_file_that_is_no_bag_is_rejected(tmp_path, suffix):
    path = tmp_path / f"broken{suffix}"
    path.write_bytes(b"\0nothing of the kind" * 40)
    with pytest.raises(MalformedDrive, match=f"broken{suffix} cannot be read as a bag"):
        open_drive(path)


def test_a_truncated_bag_raises_and_never_returns_other_scans(bags, tmp_path):
    body = bags["mcap file"].read_bytes()
    for share in range(1, 20):
        path = tmp_path / f"{share}.mcap"
        path.write_bytes(body[: len(body) * share // 20])
        try:
            drive = open_drive(path)
        except (MalformedDrive, EmptyDrive):
            continue
        for index in range(len(drive)):
            np.testing.assert_array_equal(drive.scan(index).points_m, DRIVE[index])


@pytest.mark.parametrize("format_", [">f4", "<f8", ">f8"])
def test_either_byte_order_and_width_is_read(tmp_path, format_):
    record = np.dtype([("x", format_), ("y", format_), ("z", format_)])
    bag = record_bag(tmp_path / "bag", [cloud(DRIVE[0], record=record, lines=1, padding=0)])
    np.testing.assert_allclose(open_drive(bag).scan(0).points_m, DRIVE[0], rtol=1e-6)


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"fields": []}, MalformedScan, "no x"),
        ({"point_step": 8}, MalformedScan, "8 bytes"),
        ({"row_step": 4}, TruncatedScan, "do not fit"),
        ({"height": 3}, TruncatedScan, "3 rows"),
        ({"width": 2**31}, TruncatedScan, "do not fit"),
        ({"height": 0, "width": 0}, TooFewReturns, "0"),
    ],
)
def test_a_cloud_that_does_not_fit_itself_is_rejected(tmp_path, changed, error, message):
    drive = open_drive(record_bag(tmp_path / "bag", [cloud(DRIVE[0], **changed)]))
    with pytest.raises(error, match=message):
        drive.scan(0)


def test_coordinates_that_are_integers_are_rejected(tmp_path):
    record = np.dtype([("x", "<i4"), ("y", "<f4"), ("z", "<f4")])
    drive = open_drive(record_bag(tmp_path / "bag", [cloud(DRIVE[0], record=record)]))
    with pytest.raises(WrongDtype, match="datatype 5"):
        drive.scan(0)


def test_without_the_library_the_error_has_what_to_install(bags, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(MalformedDrive, match=r"pip install .\.\[ros\]"):
        open_drive(bags["mcap"])
