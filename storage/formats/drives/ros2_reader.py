"""The library's reader of ROS 2 bags, for files that nobody has to trust.

Import it where a bag is opened: the library is an extra.
"""

import re
from contextlib import ExitStack
from pathlib import Path, PosixPath
from types import MappingProxyType

from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from storage.formats.drives.ros_definitions import require_plain_idl

_OF_URLS = re.compile("[%?#]")  # with a meaning of their own in a URL that SQLite opens


class BagPath(PosixPath):
    """A path as the library needs it, which derives those of a folder's files from it."""

    @property
    def suffix(self) -> str:
        """The suffix in small letters: by it the library chooses how to read a bag."""
        return super().suffix.lower()

    def __format__(self, spec: str) -> str:
        """Return it as a part of the URL by which the library has SQLite open a bag.

        SQLite decodes that: `%2e%2e%2f` in a name would lead out of the folder, `?` set an option.
        """
        return _OF_URLS.sub(lambda found: f"%{ord(found[0]):02x}", super().__format__(spec))


class _SqliteReader(Sqlite3Reader):
    """Also opens what the library unpacked of a packed bag as a `BagPath`."""

    def __init__(self, path: Path) -> None:
        super().__init__(BagPath(path))


class _FolderReader(DirectoryReader):
    STORAGE_PLUGINS = MappingProxyType(
        {**DirectoryReader.STORAGE_PLUGINS, "sqlite3": _SqliteReader}
    )


class Ros2Reader(Reader):
    """A reader that checks definitions before the library parses them."""

    STORAGE_PLUGINS = MappingProxyType({**Reader.STORAGE_PLUGINS, "dir": _FolderReader})

    def open(self) -> None:
        """Open the bag.

        Raises:
            MalformedDrive: If a definition would take the library too long.
        """
        super().open()
        with ExitStack() as closed_on_error:
            closed_on_error.callback(self.close)
            for one in self.connections:
                if one.msgdef.format == MessageDefinitionFormat.IDL:
                    require_plain_idl(one.msgtype, one.msgdef.data)
            closed_on_error.pop_all()
