"""Drives that are ROS bags: each PointCloud2 message of one topic is a scan.

Bags of ROS 1 and ROS 2, as SQLite or MCAP; the library that reads them is an extra. The layout of
messages: https://docs.ros.org/en/api/sensor_msgs/html/msg/PointCloud2.html
"""

import struct
import weakref
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from sqlite3 import SQLITE_NOMEM
from typing import TYPE_CHECKING, Any

import numpy as np

from core.arrays import Float32Array, FloatArray, frozen
from core.errors import EmptyDrive, InvalidScan, TensorMapError
from core.scans.pose import UNKNOWN_POSE
from core.scans.scan import Scan
from storage.errors import StorageError, StorageReadOnly
from storage.files.files import named_disk_errors
from storage.formats.budget import BUDGET
from storage.formats.drives.ros_definitions import require_items_of_bytes
from storage.formats.errors import MalformedDrive, MalformedScan, TruncatedScan, WrongDtype
from storage.formats.scans.coordinates import AXES, coordinates, record_of
from storage.formats.scans.metres import require_metres

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

BAG_SUFFIXES = frozenset({".bag", ".mcap", ".db3"})
METADATA = "metadata.yaml"
"""In the folder of a ROS 2 recording."""
_INFORMATION, _INFORMATION_WITHIN_BYTES = b"rosbag2_bagfile_information", 2**16
_CLOUD = "sensor_msgs/msg/PointCloud2"
_FLOATS = {7: "f4", 8: "f8"}  # sensor_msgs/PointField: FLOAT32, FLOAT64
_OTHER_SCHEMAS = frozenset({"ros1msg", "protobuf", "flatbuffer", "jsonschema"})
"""Of MCAP's registry (mcap.dev/spec/registry), those that the library does not know."""
_NANO = 1e-9
_STAMP_AT, _STAMP_LITTLE, _STAMP_BIG = 4, struct.Struct("<II"), struct.Struct(">II")
_LIBRARY = "rosbags.highlevel"


def is_ros_bag(path: Path) -> bool:
    """Return whether a path is a bag: a file by its suffix, a folder by its metadata."""
    return (path.suffix.lower() in BAG_SUFFIXES and path.is_file()) or _has_metadata(path)


def _has_metadata(folder: Path) -> bool:
    """Return whether a folder has the metadata of a recording: other files have their name too."""
    if not (folder / METADATA).is_file():
        return False
    try:
        with (folder / METADATA).open("rb") as file:
            return _INFORMATION in file.read(_INFORMATION_WITHIN_BYTES)
    except OSError:  # who reads the bag says why not
        return True


def _has_bag_reader() -> bool:
    """Return whether the library that reads bags is installed."""
    try:
        return find_spec(_LIBRARY) is not None
    except ModuleNotFoundError:
        return False


def require_bag_reader(name: str, where: str = "") -> None:
    """Raise `MalformedDrive` if the library that reads bags is not installed; `where` it is not."""
    if not _has_bag_reader():
        raise MalformedDrive(
            f"to read {name}, Python's rosbags is needed{where}: pip install -e '.[ros]' in a clone"
        )


def split_topic(path: Path) -> tuple[Path, str | None]:
    """Return a bag's path and the topic that follows it, as in `monday.bag#/velodyne_points`.

    Examples:
        >>> split_topic(Path("monday.bag"))[1] is None
        True
    """
    bag, mark, topic = str(path).rpartition("#")  # the last: no topic has one, a folder may
    if mark and not path.exists() and is_ros_bag(Path(bag)):
        return Path(bag), topic
    return path, None


class RosDrive:
    """The clouds of one topic, read on demand; sequential access is the fastest.

    Attributes:
        name: A short name.
        timestamp_s: `(K,)` seconds, the stamps of the messages' headers; the times at which they
            were recorded if a stamp is not set or they do not rise.
        poses: `(K, 7)`, all unknown: PointCloud2 has no pose.
    """

    def __init__(
        self, name: str, reader: "AnyReader", connections: list["Connection"], *, min_returns: int
    ) -> None:
        self.name = name
        self._reader = reader
        weakref.finalize(self, _close, reader)
        self._connections = connections
        self._min_returns = min_returns
        self._time_ns: list[int] = []
        stamps_ns = []
        for _, time_ns, raw in reader.messages(connections):
            self._time_ns.append(time_ns)
            stamps_ns.append(_stamp_ns(raw, is_cdr=reader.is2))
        # Not in a folder of several files of which a later one begins earlier.
        self._rises = all(earlier <= later for earlier, later in pairwise(self._time_ns))
        times_ns = stamps_ns if _are_times(stamps_ns) else self._time_ns
        self.timestamp_s: FloatArray = frozen(np.array(times_ns) * _NANO, np.float64)
        self.poses: FloatArray = frozen(np.full((len(self), 7), UNKNOWN_POSE), np.float64)
        self._next = 0
        self._messages: Iterator[tuple[Connection, int, bytes]] = iter(())

    def __len__(self) -> int:
        return len(self._time_ns)

    def scan(self, index: int) -> Scan:
        """Return the scan of message `index`, 0-based.

        Raises:
            InvalidScan: If the message is no cloud of x, y and z; a subclass says why.
            MalformedDrive: If the bag cannot be read there.
        """
        index = range(len(self))[index]
        with _named_errors(MalformedDrive, f"{self.name} cannot be read at message {index}"):
            at, self._next = self._next, -1  # until the message was read
            if index != at or index == 0:
                self._seek(index, at)
            connection, _, raw = self._take()
        self._next = index + 1
        with _named_errors(MalformedScan, f"message {index} of {self.name} cannot be read"):
            returns_m = returns_m_of(self._reader.deserialize(raw, connection.msgtype))
        scan = Scan.from_returns(
            returns_m,
            min_returns=self._min_returns,
            timestamp_s=float(self.timestamp_s[index]),
        )
        require_metres(scan.points_m)
        return scan

    def _seek(self, index: int, at: int) -> None:
        """Go from message `at` to another: by its time or, where times fall, by counting."""
        begin_ns = None
        if self._rises:
            begin_ns = self._time_ns[index]
            at = bisect_left(self._time_ns, begin_ns)  # the first of the same nanosecond
        elif not 0 < at <= index:
            at = 0
        if self._rises or at == 0:
            self._messages = iter(self._reader.messages(self._connections, start=begin_ns))
        for _ in range(index - at):
            self._take()

    def _take(self) -> tuple["Connection", int, bytes]:
        for message in self._messages:
            return message
        raise EOFError("it has fewer messages than when it was opened")


def _close(reader: "AnyReader") -> None:
    """Close a bag that nobody reads any more.

    SQLite refuses while a message is open, and closes the bag when that is removed a moment later.
    """
    with suppress(Exception):
        reader.close()


def _stamp_ns(raw: bytes, *, is_cdr: bool) -> int:
    """Return the stamp of a message's header, 0 if it is not set.

    It follows the header's `seq` in ROS 1, and the encapsulation in ROS 2, of which byte 1 is 0 for
    big-endian numbers: a cloud need not be parsed for it.
    """
    if len(raw) < _STAMP_AT + _STAMP_LITTLE.size:
        return 0
    layout = _STAMP_BIG if is_cdr and raw[1] % 2 == 0 else _STAMP_LITTLE
    seconds, nanoseconds = layout.unpack_from(raw, _STAMP_AT)
    return int(seconds) * 10**9 + int(nanoseconds)


def _are_times(stamps_ns: list[int]) -> bool:
    """Return whether stamps were set by a clock: none is 0, none falls, and not all are equal."""
    if not all(stamps_ns) or any(later < earlier for earlier, later in pairwise(stamps_ns)):
        return False
    return len(stamps_ns) == 1 or len(set(stamps_ns)) > 1


@contextmanager
def _named_errors(malformed: type[TensorMapError], what: str) -> Iterator[None]:
    """Raise `malformed` for any error of the library's parser, or of messages defined otherwise.

    A lack of memory or a full or failing disk is not the bag's fault, and keeps its own name.
    """
    try:
        with named_disk_errors("the temporary folder"):  # of unpacked bags
            yield
    except StorageReadOnly as error:  # its cause names the file, mostly the bag
        raise malformed(f"{what}: {error.__cause__}") from error
    except (InvalidScan, MemoryError, StorageError):
        raise
    except Exception as error:
        if _lacks_memory(error):
            raise MemoryError(what) from error
        raise malformed(f"{what}: {str(error) or type(error).__name__}") from error


def _lacks_memory(error: BaseException | None) -> bool:
    """Return whether an error is SQLite's lack of memory, or was raised from it."""
    while error is not None:
        # Attributes of Python's driver, and of the one that later versions of the library use.
        codes = (getattr(error, "sqlite_errorcode", None), getattr(error, "result", None))
        if SQLITE_NOMEM in codes:
            return True
        error = error.__cause__ or error.__context__
    return False


def returns_m_of(cloud: Any) -> Float32Array:  # noqa: ANN401 - its class is defined in the bag
    """Return the points of a PointCloud2, `(n, 3)` metres.

    Raises:
        MalformedScan: If it has points, and no x, y and z within them.
        WrongDtype: If they are not floating point.
        TruncatedScan: If it has fewer bytes than its rows need; the padding of the last one may
            be left out.
        ScanTooLarge: If it has more points than a scan may.
    """
    fields = {field.name: field for field in cloud.fields}
    for axis in AXES:
        if axis not in fields:
            raise MalformedScan(f"a cloud of the fields {', '.join(fields)} has no {axis}")
    order = ">" if cloud.is_bigendian else "<"
    kinds = {axis: _FLOATS.get(fields[axis].datatype) for axis in AXES}
    for axis, kind in kinds.items():
        if kind is None or fields[axis].count not in {0, 1}:  # some drivers leave the count out
            raise WrongDtype(
                f"{axis} is {fields[axis].count} of PointField's datatype {fields[axis].datatype},"
                " wanted one of 7 or 8: floating point"
            )
    if not cloud.height * cloud.width:  # some drivers leave the sizes of points out then
        return np.empty((0, 3), np.float32)
    layout = {axis: (f"{order}{kinds[axis]}", fields[axis].offset) for axis in AXES}
    for axis, (kind, offset) in layout.items():
        end = offset + np.dtype(kind).itemsize
        if end > cloud.point_step:
            raise MalformedScan(
                f"points of {cloud.point_step} bytes have {axis} at bytes {offset} to {end - 1}"
            )
    record = record_of(layout, cloud.point_step)
    data = np.asarray(cloud.data, dtype=np.uint8)
    row_bytes, step_bytes = cloud.width * cloud.point_step, cloud.row_step
    if cloud.height == 1 or len(data) == cloud.height * row_bytes:
        step_bytes = row_bytes  # some drivers set another one, or leave it 0
    before_last = (cloud.height - 1) * step_bytes
    if step_bytes < row_bytes or len(data) < before_last + row_bytes:
        raise TruncatedScan(
            f"{cloud.height} rows of {cloud.width} points of {cloud.point_step} bytes do not fit"
            f" into {len(data)} bytes, {cloud.row_step} a row"
        )
    BUDGET.require_returns(cloud.height * cloud.width)
    packed = np.ascontiguousarray(data[: before_last + row_bytes])
    if step_bytes > row_bytes:
        rows = data[:before_last].reshape(cloud.height - 1, step_bytes)[:, :row_bytes]
        packed = np.concatenate([rows.reshape(-1), data[before_last:][:row_bytes]])
    return coordinates(packed.view(record))


def open_ros_drive(path: Path, topic: str | None = None, *, min_returns: int = 1) -> RosDrive:
    """Open a bag; it stays open as long as the drive is referenced.

    Args:
        path: A `.bag` of ROS 1, an `.mcap` or `.db3`, or the folder that ROS 2 recorded.
        topic: The topic of the scans; not needed where only one has clouds.
        min_returns: Least number of finite, non-zero returns of a scan.

    Raises:
        MalformedDrive: If the library is not installed, the bag cannot be read, or several topics
            have clouds and none is given.
        EmptyDrive: If the topic has no message.
        StorageError: If the disk is full, fails or cannot be read.
    """
    require_bag_reader(path.name)
    with _named_errors(MalformedDrive, f"{path.name} cannot be read as a bag"):
        reader, clouds = _opened(path)
    try:
        require_items_of_bytes(path.name, _CLOUD, reader.typestore.fielddefs)
        of_topic = _of_topic(path.name, clouds, topic)
    except MalformedDrive:
        reader.close()
        raise
    with _named_errors(MalformedDrive, f"{path.name} cannot be read as a bag"):
        drive = RosDrive(path.stem, reader, of_topic, min_returns=min_returns)
    if not len(drive):
        raise EmptyDrive(f"topic {of_topic[0].topic} of {path.name} has no message")
    return drive


def require_topic(path: Path, topic: str | None) -> None:
    """Check the topics of a bag; nothing if it cannot be opened here.

    Raises:
        MalformedDrive: If it lacks the topic, or several have clouds and none is given.
    """
    if not _has_bag_reader():
        return
    try:
        with _named_errors(MalformedDrive, path.name):
            reader, clouds = _opened(path)
    except MalformedDrive:  # who reads it says why not
        return
    reader.close()
    _of_topic(path.name, clouds, topic)


def _opened(path: Path) -> tuple["AnyReader", list["Connection"]]:
    """Return a bag, and its connections with clouds."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    from storage.formats.drives.ros2_reader import BagPath, Ros2Reader

    # Bags as SQLite may hold no definitions: PointCloud2 has been the same in all of ROS 2.
    reader = AnyReader([BagPath(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
    if reader.is2:
        reader.readers = [Ros2Reader(BagPath(path))]
    try:
        reader.open()
    except KeyError as error:
        if error.args[0] not in _OTHER_SCHEMAS:
            raise
        raise MalformedDrive(
            f"it has messages defined as {error.args[0]}, wanted ROS 2's alone, ros2msg or ros2idl;"
            " of ROS 1 a .bag is read"
        ) from error
    return reader, [one for one in reader.connections if one.msgtype == _CLOUD]


def _of_topic(name: str, clouds: list["Connection"], topic: str | None) -> list["Connection"]:
    """Return the connections of a topic, by default of the only one with messages.

    Raises:
        MalformedDrive: If there are none, or several topics to choose from.
    """
    topics: Counter[str] = Counter()
    for one in clouds:
        topics[one.topic] += one.msgcount
    wanted = "one topic" if topic is None else f"topic {topic}"
    if topic is None and topics:
        most = max(sorted(topics), key=topics.__getitem__)
        # A topic may have been announced only; where none has a message, each could be meant.
        if len(topics) == 1 or sum(count > 0 for count in topics.values()) == 1:
            topic = most
        wanted += f", or its name after a #, as 'BAG#{most}'"
    of_topic = [one for one in clouds if one.topic == topic]
    if not of_topic:
        has = ", ".join(f"{found} ({count})" for found, count in sorted(topics.items())) or "none"
        raise MalformedDrive(f"{name} has these topics of PointCloud2: {has}; wanted {wanted}")
    return of_topic
