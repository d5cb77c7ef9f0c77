"""The recordings that can be uploaded as captures, opened from the files of one."""

from collections.abc import Sequence
from pathlib import Path, PurePath

from core.scans.drive import Drive
from storage.formats.drives.captured_drive import open_captured_drive
from storage.formats.drives.ros_drive import (
    BAG_SUFFIXES,
    METADATA,
    open_ros_drive,
    require_bag_reader,
)
from storage.formats.errors import UnknownDriveLayout

_PCAP = ".pcap"
_STORAGE = frozenset({".db3", ".mcap"})  # of ROS 2
_MOST_SHOWN = 5


def require_readable(names: Sequence[str], topic: str | None) -> None:
    """Reject files that are no recording, before they are sent.

    Args:
        names: The files' names.
        topic: The topic of the scans in a bag.

    Raises:
        UnknownDriveLayout: If the files are not a recording.
        MalformedDrive: If they are a bag, and its library is not installed.
    """
    if len(set(names)) < len(names):
        raise UnknownDriveLayout("two files have the same name")
    suffixes = {PurePath(name).suffix.lower() for name in names if name != METADATA}
    if len(names) == 1 and suffixes == {_PCAP}:
        if topic is not None:
            raise UnknownDriveLayout(f"a {_PCAP} has no topics, {topic[:80]!r} was given")
        return
    is_folder = METADATA in names and len(suffixes) == 1 and suffixes <= _STORAGE
    if not is_folder and not (len(names) == 1 and suffixes <= BAG_SUFFIXES and suffixes):
        shown = ", ".join(names[:_MOST_SHOWN]) + (" and more" if len(names) > _MOST_SHOWN else "")
        raise UnknownDriveLayout(
            f"the files are {shown}, wanted one .pcap, .bag, .mcap or .db3, or {METADATA} and the"
            " .db3 or .mcap of a folder that ROS 2 recorded"
        )
    require_bag_reader(names[0], " on the service's machine")


def open_recording(
    folder: Path, names: Sequence[str], topic: str | None, *, min_returns: int
) -> Drive:
    """Open the recording in a folder that has these files and nothing else.

    Raises:
        TensorMapError: What its reader raises; nothing else is tried.
    """
    path = folder if len(names) > 1 else folder / names[0]
    if path.suffix.lower() == _PCAP:
        return open_captured_drive(path, min_returns=min_returns)
    return open_ros_drive(path, topic, min_returns=min_returns)
