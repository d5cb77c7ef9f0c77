"""Bags of ROS 1 and ROS 2 with clouds."""

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from ruamel.yaml import YAML

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


def cloud(points, ros=2, *, stamp_ns=0, record=RECORD, lines=2, padding=3, **changed):
    """Return a message: points with padding, in rows with padding."""
    types = STORES[ros].types
    rows = np.zeros(len(points), record)
    for column, axis in enumerate("xyz"):
        rows[axis] = points[:, column]
    width = len(points) // lines
    data = rows.view(np.uint8).reshape(lines, width * record.itemsize)
    data = np.pad(data, ((0, 0), (0, padding)))
    sec, nanosec = divmod(stamp_ns, 10**9)
    stamp = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
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


def record_bag(
    path: Path,
    messages,
    topics=("/points",),
    ros=2,
    plugin=StoragePlugin.MCAP,
    times_ns=TIMES_NS,
    quiet=(),
    first_only=(),
) -> Path:
    """Write each message to every topic; return what a user would name.

    Topics `quiet` get none, topics `first_only` the first.
    """
    store = STORES[ros]
    writer: Any = Writer1(path.with_suffix(".bag"))
    if ros == 2:
        writer = Writer2(path, version=9, storage_plugin=plugin)
    with writer:
        to, once, _ = (
            [writer.add_connection(topic, CLOUD, typestore=store) for topic in some]
            for some in (topics, first_only, quiet)
        )
        write = store.serialize_ros1 if ros == 1 else store.serialize_cdr
        for message, time_ns in zip(messages, times_ns, strict=False):
            for connection in to + once:
                writer.write(connection, time_ns, write(message, CLOUD))
            once = []
    return path.with_suffix(".bag") if ros == 1 else path


def record_other_clouds(path: Path) -> Path:
    """Write a bag of ROS 1 in which PointCloud2 is defined otherwise, without fields."""
    store = get_typestore(Stores.EMPTY)
    definition = f"Header header\n{'=' * 80}\nMSG: std_msgs/Header\nuint32 seq\n"
    store.register(get_types_from_msg(definition, CLOUD))
    header = store.types["std_msgs/msg/Header"](seq=1)
    with Writer1(path) as writer:
        to = writer.add_connection("/points", CLOUD, typestore=store)
        message = store.types[CLOUD](header=header)
        writer.write(to, BEGIN_NS, bytes(store.serialize_ros1(message, CLOUD)))
    return path


def record_defined_clouds(path: Path, definition: str, raw: bytes) -> Path:
    """Write a bag of ROS 1 with one message, of PointCloud2 as `definition` has it."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, CLOUD))
    with Writer1(path) as writer:
        writer.write(writer.add_connection("/points", CLOUD, typestore=store), BEGIN_NS, raw)
    return path


def record_parts(path: Path, parts_ns, plugin=StoragePlugin.MCAP) -> Path:
    """Write `DRIVE` as a folder of ROS 2 with a file for each list of times."""
    path.mkdir()
    names = []
    clouds = iter([cloud(points) for points in DRIVE])
    for number, times_ns in enumerate(parts_ns):
        messages = [next(clouds) for _ in times_ns]
        part = path / f"part{number}"
        record_bag(part, messages, plugin=plugin, times_ns=times_ns)
        [file] = (file for file in part.iterdir() if file.name != "metadata.yaml")
        names.append(file.rename(path / f"{part.name}{file.suffix}").name)
    yaml = YAML(typ="safe")
    metadata = yaml.load(path / "part0" / "metadata.yaml")
    information = metadata["rosbag2_bagfile_information"]
    count = sum(map(len, parts_ns))
    information |= {"relative_file_paths": names, "message_count": count, "files": []}
    information["topics_with_message_count"][0]["message_count"] = count
    yaml.dump(metadata, path / "metadata.yaml")
    return path
