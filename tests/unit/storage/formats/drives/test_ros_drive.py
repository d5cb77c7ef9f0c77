"""Bags of ROS 1 and ROS 2: every kind gives the same drive."""

import errno
import shutil
import sqlite3
import sys
import tempfile
import weakref
from unittest import mock

import apsw
import numpy as np
import pytest
import zstandard
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_idl, get_typestore
from ruamel.yaml import YAML

from core.errors import EmptyDrive, TooFewReturns
from storage.errors import StorageFull, StorageUnavailable
from storage.formats.budget import Budget
from storage.formats.drives import ros_drive
from storage.formats.drives.layouts import open_drive
from storage.formats.drives.topics import without_topic
from storage.formats.errors import (
    MalformedDrive,
    MalformedScan,
    ScanTooLarge,
    TruncatedScan,
    WrongDtype,
)
from tests.support.bags import (
    BEGIN_NS,
    CLOUD,
    DRIVE,
    TIMES_NS,
    cloud,
    record_bag,
    record_defined_clouds,
    record_other_clouds,
    record_parts,
)


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


@pytest.mark.parametrize("kind", ["ros1", "sqlite", "mcap"])
def test_a_bag_that_is_read_in_part_is_left_without_a_fault(bags, collect_own, kind):
    drive = open_drive(bags[kind])
    drive.scan(0)
    # Then its message is open when it is closed; from Python 3.12 on it always is.
    vars(drive)["itself"] = drive
    opened = weakref.ref(drive)
    del drive
    collect_own()
    assert opened() is None


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


@pytest.mark.parametrize("kind", ["ros1", "sqlite file", "mcap file"])
def test_a_bag_may_have_its_suffix_in_capitals(bags, tmp_path, kind):
    named = tmp_path / f"MONDAY{bags[kind].suffix.upper()}"
    named.symlink_to(bags[kind])
    drive = open_drive(named)
    assert drive.name == "MONDAY"
    np.testing.assert_array_equal(drive.scan(2).points_m, DRIVE[2])


def named_as(bag, folder, name, kind):
    """Return the path of a bag whose one file has another name, and is packed, or in no folder."""
    folder.mkdir()
    [file] = bag.glob("*.db3")
    if kind == "file":
        return shutil.copy(file, folder / name)
    packed = kind == "packed"
    stored = folder / (f"{name}.zstd" if packed else name)
    content = file.read_bytes()
    stored.write_bytes(zstandard.compress(content) if packed else content)
    yaml = YAML(typ="safe")
    metadata = yaml.load(bag / "metadata.yaml")
    information = metadata["rosbag2_bagfile_information"]
    information["relative_file_paths"] = [stored.name]
    if packed:
        information |= {"compression_mode": "FILE", "compression_format": "zstd"}
    yaml.dump(metadata, folder / "metadata.yaml")
    return folder


@pytest.mark.parametrize("kind", ["file", "folder", "packed"])
@pytest.mark.parametrize("name", ["%2e%2e%2fother.db3", "a #1.db3", "a?mode=memory.db3"])
def test_a_bag_is_the_file_of_its_name_whatever_that_means_in_a_url(bags, tmp_path, name, kind):
    """SQLite opens it by a URL: `%2e%2e%2f` led out of a capture's folder, to any file there is."""
    shutil.copy(bags["sqlite file"], tmp_path / "other.db3")
    own = [cloud(points + 1) for points in DRIVE[:2]]
    bag = record_bag(tmp_path / "own", own, plugin=StoragePlugin.SQLITE3)
    drive = open_drive(named_as(bag, tmp_path / "bag#2 %41", name, kind))
    assert len(drive) == len(own)
    np.testing.assert_array_equal(drive.scan(1).points_m, DRIVE[1] + 1)


@pytest.mark.parametrize("name", ["at 100%41", "a?b", "a#b"])
def test_a_packed_bag_is_unpacked_into_a_folder_of_any_name(
    bags, tmp_path, monkeypatch, collect_own, name
):
    """A service unpacks it in its data directory, a command in TMPDIR."""
    (tmp_path / name).mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / name))
    drive = open_drive(named_as(bags["sqlite"], tmp_path / "bag", "two.db3", "packed"))
    np.testing.assert_array_equal(drive.scan(1).points_m, DRIVE[1])
    del drive
    collect_own()
    assert not list((tmp_path / name).iterdir())


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize(
    ("stamps_ns", "used"),
    [
        ([BEGIN_NS + 1, BEGIN_NS + 2, BEGIN_NS + 2, BEGIN_NS + 10**9 + 1], True),
        ([1, 10**9, 2 * 10**9, 3 * 10**9], True),  # since the sensor's start
        ([0, 1, 2, 3], False),
        ([BEGIN_NS, BEGIN_NS + 2, BEGIN_NS + 1, BEGIN_NS + 3], False),
        ([BEGIN_NS] * 4, False),
    ],
)
def test_a_scans_time_is_its_stamp_where_all_are_set_and_rise(tmp_path, ros, stamps_ns, used):
    clouds = [
        cloud(points, ros, stamp_ns=stamp_ns)
        for points, stamp_ns in zip(DRIVE, stamps_ns, strict=True)
    ]
    drive = open_drive(record_bag(tmp_path / "bag", clouds, ros=ros))
    times_ns = stamps_ns if used else TIMES_NS
    np.testing.assert_allclose(drive.timestamp_s, np.array(times_ns) * 1e-9, rtol=1e-15)
    for index in (2, 0, 3):  # found by the time of recording
        np.testing.assert_array_equal(drive.scan(index).points_m, DRIVE[index])


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("parts", [[[3, 4], [1, 2]], [[1, 3], [2, 4]], [[2, 2], [1, 2]]])
@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0), (1, 3, 0, 0, 2, 1, 1), (2, -1, 0)])
def test_a_scan_is_its_message_where_a_later_file_begins_earlier(tmp_path, plugin, parts, order):
    parts_ns = [[BEGIN_NS + time for time in part] for part in parts]
    drive = open_drive(record_parts(tmp_path / "split", parts_ns, plugin))
    assert len(drive) == len(DRIVE)
    for index in order:
        np.testing.assert_array_equal(drive.scan(index).points_m, DRIVE[index])


@pytest.mark.parametrize("step", [1, 2])
def test_a_bag_whose_times_fall_is_read_once_from_its_begin_to_its_end(tmp_path, monkeypatch, step):
    parts_ns = [[BEGIN_NS + 3, BEGIN_NS + 4], [BEGIN_NS + 1, BEGIN_NS + 2]]
    drive = ros_drive.open_ros_drive(record_parts(tmp_path / "split", parts_ns))
    begun = mock.Mock(side_effect=drive._reader.messages)
    monkeypatch.setattr(drive._reader, "messages", begun)
    for index in range(0, len(DRIVE), step):
        np.testing.assert_array_equal(drive.scan(index).points_m, DRIVE[index])
    assert begun.call_count == 1


def test_a_bag_that_ends_earlier_than_before_is_rejected_and_no_other_scan_is_read(
    bags, monkeypatch
):
    drive = open_drive(bags["mcap"])
    with monkeypatch.context() as patched:
        patched.setattr(AnyReader, "messages", lambda *_, **__: iter(()))
        for index in (2, 0):
            with pytest.raises(MalformedDrive, match=f"at message {index}: it has fewer messages"):
                drive.scan(index)
    np.testing.assert_array_equal(drive.scan(0).points_m, DRIVE[0])


def test_an_error_of_the_parser_without_a_text_is_named(bags, monkeypatch):
    drive = open_drive(bags["mcap"])
    monkeypatch.setattr(AnyReader, "messages", mock.Mock(side_effect=AssertionError))
    with pytest.raises(MalformedDrive, match=r"three cannot be read at message 0: AssertionError$"):
        drive.scan(0)


def test_a_cloud_in_millimetres_is_rejected(tmp_path):
    drive = open_drive(record_bag(tmp_path / "bag", [cloud(DRIVE[0] * 1000)]))
    with pytest.raises(WrongDtype, match="millimetres"):
        drive.scan(0)


def test_a_cloud_of_more_points_than_a_scan_may_have_is_rejected(monkeypatch):
    monkeypatch.setattr(ros_drive, "BUDGET", Budget(returns=39))
    with pytest.raises(ScanTooLarge, match="40 returns, at most 39"):
        ros_drive.returns_m_of(cloud(DRIVE[0]))


def test_a_folder_of_scans_with_metadata_that_are_not_of_ros_is_no_bag(tmp_path):
    np.save(tmp_path / "0.npy", DRIVE[0])
    (tmp_path / "metadata.yaml").write_text("sensor: HDL-64E\n")
    drive = open_drive(tmp_path)
    assert len(drive) == 1
    np.testing.assert_array_equal(drive.scan(0).points_m, DRIVE[0])


def test_a_bag_whose_metadata_may_not_be_read_is_still_taken_for_one(bags, monkeypatch):
    def denied(*_):
        raise PermissionError

    monkeypatch.setattr("pathlib.Path.open", denied)
    assert ros_drive.is_ros_bag(bags["mcap"])  # who reads it says why not


def test_one_of_several_topics_is_named_after_the_bag(tmp_path):
    bag = record_bag(tmp_path / "bag", [cloud(DRIVE[0])], topics=("/front", "/rear"))
    with pytest.raises(MalformedDrive, match=r"/front \(1\), /rear \(1\); wanted one topic"):
        open_drive(bag)
    assert len(open_drive(tmp_path / "bag#/rear")) == 1
    with pytest.raises(MalformedDrive, match="wanted topic /top"):
        open_drive(tmp_path / "bag#/top")


@pytest.mark.parametrize("folder", ["run#3", "run#"])
def test_a_bag_in_a_folder_with_a_number_sign_may_have_a_topic(bags, tmp_path, folder):
    bag = tmp_path / folder / "monday.bag"
    bag.parent.mkdir()
    bag.symlink_to(bags["ros1"])
    assert ros_drive.split_topic(bag) == (bag, None)
    of_topic = tmp_path / folder / "monday.bag#/points"
    assert ros_drive.split_topic(of_topic) == (bag, "/points")
    assert without_topic(of_topic) == bag
    assert len(open_drive(of_topic)) == len(DRIVE)


def test_a_topic_without_a_message_is_none_to_choose_from(tmp_path):
    clouds = [cloud(points) for points in DRIVE]
    bag = record_bag(tmp_path / "bag", clouds, topics=("/points",), quiet=("/map", "/world"))
    assert len(open_drive(bag)) == len(DRIVE)
    ros_drive.require_topic(bag, None)
    with pytest.raises(EmptyDrive, match="topic /map of bag has no message"):
        open_drive(f"{bag}#/map")
    silent = record_bag(tmp_path / "silent", [], topics=(), quiet=("/map", "/world"))
    with pytest.raises(MalformedDrive, match=r"/map \(0\), /world \(0\); wanted one topic"):
        open_drive(silent)


def test_of_several_topics_that_with_most_messages_is_proposed(tmp_path):
    clouds = [cloud(points) for points in DRIVE]
    bag = record_bag(
        tmp_path / "bag", clouds, topics=("/top", "/rear"), quiet=("/map",), first_only=("/front",)
    )
    with pytest.raises(
        MalformedDrive,
        match=r"/front \(1\), /map \(0\), /rear \(4\), /top \(4\); wanted .* 'BAG#/rear'",
    ):
        open_drive(bag)


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


@pytest.mark.parametrize("method", ["open", "messages", "deserialize"])
@pytest.mark.parametrize(
    ("error", "named"),
    [
        (MemoryError("no memory"), MemoryError),
        (OSError(errno.EFBIG, "File too large"), StorageFull),  # beyond `ulimit -f`
        (OSError(errno.EIO, "Input/output error"), StorageUnavailable),
        (KeyError("of the parser"), (MalformedDrive, MalformedScan)),
    ],
)
def test_only_what_the_parser_raises_is_the_bags_fault(bags, monkeypatch, method, error, named):
    drive = open_drive(bags["mcap"])
    monkeypatch.setattr(AnyReader, method, mock.Mock(side_effect=error))
    with pytest.raises(named):
        drive.scan(0) if method != "open" else open_drive(bags["mcap"])


def test_a_bag_that_may_not_be_read_is_named_and_nothing_is_to_be_made_writable(bags, monkeypatch):
    locked = PermissionError(errno.EACCES, "Permission denied", "three/metadata.yaml")
    monkeypatch.setattr(AnyReader, "open", mock.Mock(side_effect=locked))
    with pytest.raises(
        MalformedDrive, match=r"^three cannot be read as a bag: .*denied: 'three/meta"
    ):
        open_drive(bags["mcap"])


def test_a_full_disk_that_stops_the_unpacking_of_a_bag_is_that_of_temporary_files(
    bags, monkeypatch
):
    full = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(AnyReader, "open", mock.Mock(side_effect=full))
    with pytest.raises(StorageFull, match=r"^no space is left in the temporary folder: free some"):
        open_drive(bags["mcap"])


def refused(error: Exception, **attributes: int) -> Exception:
    """An error as a library raises it for SQLite's."""
    for name, value in attributes.items():
        setattr(error, name, value)
    return error


@pytest.mark.parametrize(
    "error",
    [
        refused(sqlite3.OperationalError("out of memory"), sqlite_errorcode=7),
        refused(RuntimeError("out of memory"), result=7),  # of APSW
    ],
)
def test_a_lack_of_memory_of_sqlite_is_not_the_bags_fault(bags, monkeypatch, error):
    drive = open_drive(bags["sqlite"])
    monkeypatch.setattr(AnyReader, "messages", mock.Mock(side_effect=error))
    with pytest.raises(MemoryError, match="two cannot be read at message 0"):
        drive.scan(0)


def test_a_lack_of_memory_is_found_behind_the_librarys_own_error(bags):
    apsw.hard_heap_limit(1)
    try:
        with pytest.raises(MemoryError, match="two cannot be read as a bag"):
            open_drive(bags["sqlite"])
    finally:
        apsw.hard_heap_limit(0)


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
        ({"point_step": 8}, MalformedScan, "points of 8 bytes have y at bytes 8 to 11"),
        ({"point_step": 0}, MalformedScan, "points of 0 bytes have x at bytes 4 to 7"),
        ({"row_step": 4}, TruncatedScan, "do not fit"),
        ({"height": 3}, TruncatedScan, "3 rows"),
        ({"width": 2**31}, TruncatedScan, "do not fit"),
        ({"height": 0, "width": 0}, TooFewReturns, "0"),
        ({"width": 0, "point_step": 0, "row_step": 0}, TooFewReturns, "0 of 0 returns"),
        ({"row_step": 0}, TruncatedScan, "do not fit"),  # where does a row begin?
    ],
)
def test_a_cloud_that_does_not_fit_itself_is_rejected(tmp_path, changed, error, message):
    drive = open_drive(record_bag(tmp_path / "bag", [cloud(DRIVE[0], **changed)]))
    with pytest.raises(error, match=message):
        drive.scan(0)


# Velodyne's driver left it 0, PCL's concatenation counts points, PointCloud2Modifier all rows.
@pytest.mark.parametrize("row_bytes", [0, 20, 40 * 22])
def test_a_cloud_without_padding_is_read_whatever_its_row_step(tmp_path, row_bytes):
    message = cloud(DRIVE[0], padding=0, row_step=row_bytes)
    drive = open_drive(record_bag(tmp_path / "bag", [message]))
    np.testing.assert_array_equal(drive.scan(0).points_m, DRIVE[0])


@pytest.mark.parametrize(
    ("lines", "padding", "cut", "row_bytes"),
    [
        (2, 5, 5, 20 * 22 + 5),  # the last row has no padding
        (2, 5, 2, 20 * 22 + 5),
        (8, 1, 1, 5 * 22 + 1),
        (1, 3, 0, 0),  # one row, with bytes behind its points
        (1, 3, 0, 17),
        (1, 3, 1, 40 * 22 + 3),
    ],
)
def test_a_cloud_is_read_where_all_its_points_are_there(tmp_path, lines, padding, cut, row_bytes):
    whole = cloud(DRIVE[0], lines=lines, padding=padding)
    data = whole.data[: len(whole.data) - cut]
    message = cloud(DRIVE[0], lines=lines, padding=padding, data=data, row_step=row_bytes)
    drive = open_drive(record_bag(tmp_path / "bag", [message]))
    np.testing.assert_array_equal(drive.scan(0).points_m, DRIVE[0])
    cut += padding - cut + 1  # a byte of the last point too
    message = cloud(
        DRIVE[0], lines=lines, padding=padding, data=whole.data[:-cut], row_step=row_bytes
    )
    drive = open_drive(record_bag(tmp_path / "cut", [message]))
    with pytest.raises(TruncatedScan, match="do not fit"):
        drive.scan(0)


def test_an_mcap_of_ros_1_is_rejected_with_what_is_read(tmp_path):
    [file] = record_bag(tmp_path / "bag", [cloud(DRIVE[0])]).glob("*.mcap")
    file.write_bytes(file.read_bytes().replace(b"ros2msg", b"ros1msg"))  # as `mcap convert` writes
    with pytest.raises(
        MalformedDrive, match=r"messages defined as ros1msg, wanted .* a \.bag is read"
    ):
        open_drive(file)


def test_a_cloud_that_its_bag_defines_otherwise_is_rejected(tmp_path):
    drive = open_drive(record_other_clouds(tmp_path / "other.bag"))
    with pytest.raises(MalformedScan, match=r"message 0 of other cannot be read: .*'fields'"):
        drive.scan(0)


@pytest.mark.parametrize(
    ("definition", "message"),
    [
        # For each item of a fixed number the library would write and compile lines of code.
        (
            "string[999999999] data",
            r"'data' of sensor_msgs/msg/PointCloud2 is an array of 999999999",
        ),
        ("A[] some", r"'deep' of sensor_msgs/msg/A is an array of 7 items"),
        ("A[<=5] some\nuint8[9] id", r"'deep' of sensor_msgs/msg/A is an array of 7 items"),
        ("B[] none", r"sensor_msgs/msg/B has no field"),
    ],
)
def test_a_definition_by_which_few_bytes_have_many_items_is_rejected(tmp_path, definition, message):
    rule = "=" * 80
    definition += f"\n{rule}\nMSG: sensor_msgs/A\ntime[7] deep\n{rule}\nMSG: sensor_msgs/B\n"
    bag = record_defined_clouds(tmp_path / "many.bag", definition, b"\0" * 8)
    with pytest.raises(MalformedDrive, match=rf"many\.bag defines .*{message}.* wanted"):
        open_drive(bag)


IDL = """// (as ROS writes it)
module sensor_msgs { module msg {
  @verbatim (language="comment", text=/* ( */ "one (of \\"two" " texts")
  struct PointCloud2 { @unit(value="m") octet x; };
  module PointCloud2_Constants { const long SOME = %s; };
}; };
"""


@pytest.mark.parametrize(("some", "is_read"), [("-7", True), ("((7))", False), ("1+(7)", False)])
def test_a_definition_in_idl_that_would_take_hours_to_parse_is_rejected(tmp_path, some, is_read):
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_idl(IDL % 7))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        definition = f"{'=' * 80}\nIDL: sensor_msgs/msg/PointCloud2\n{IDL % some}"
        to = writer.add_connection(
            "/points", CLOUD, msgdef=definition, rihs01=store.hash_rihs01(CLOUD)
        )
        writer.write(to, BEGIN_NS, b"\0\1\0\0\7")
    if is_read:
        assert len(open_drive(tmp_path / "bag")) == 1
    else:
        with pytest.raises(MalformedDrive, match=r"PointCloud2 is defined with a constant in \(\)"):
            open_drive(tmp_path / "bag")


def test_coordinates_that_are_integers_are_rejected(tmp_path):
    record = np.dtype([("x", "<i4"), ("y", "<f4"), ("z", "<f4")])
    drive = open_drive(record_bag(tmp_path / "bag", [cloud(DRIVE[0], record=record)]))
    with pytest.raises(WrongDtype, match="datatype 5"):
        drive.scan(0)


def test_without_the_library_the_error_has_what_to_install(bags, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(MalformedDrive, match=r"pip install -e .\.\[ros\]"):
        open_drive(bags["mcap"])
