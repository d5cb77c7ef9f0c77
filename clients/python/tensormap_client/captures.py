"""Captures and ROS bags to upload: files that are sent unchanged, in parts."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tensormap_client.errors import InvalidArgument

_FILES = frozenset({".pcap", ".bag", ".mcap", ".db3"})
_METADATA = "metadata.yaml"  # in a folder that ROS 2 recorded
_INFORMATION, _INFORMATION_WITHIN_BYTES = b"rosbag2_bagfile_information", 2**16
_STORAGE = frozenset({".mcap", ".db3"})
_COMPRESSED = ".zstd"  # of a file that ROS 2 compressed as a whole


@dataclass(frozen=True)
class CaptureFiles:
    """The files of a capture or bag, one after another as one sequence of bytes.

    Attributes:
        files: The files, at least one.
        sizes: Each file's size in bytes.
        topic: The topic of the scans, for a bag with several topics of point clouds.
    """

    files: tuple[Path, ...]
    sizes: tuple[int, ...]
    topic: str | None = None

    @classmethod
    def of(cls, path: Path | str) -> "CaptureFiles | None":
        """Return the files of a path, `None` if it is not a capture.

        Args:
            path: A `.pcap`, `.bag`, `.mcap` or `.db3`, or a folder that ROS 2 recorded; a topic may
                follow a bag, as in `monday.bag#/velodyne_points`.

        Raises:
            InvalidArgument: If a folder has no files of its recording.
        """
        path, topic = Path(path), None
        name, mark, after = str(path).rpartition("#")  # the last: no topic has one, a folder may
        if mark and not path.exists() and Path(name).exists():
            path, topic = Path(name), after
        if path.is_file() and path.suffix.lower() in _FILES:
            return cls._of_files((path,), topic)
        if not _has_metadata(path):
            return None
        files = sorted(path.iterdir())
        found = [file for file in files if file.suffix.lower() in _STORAGE]
        if not found:
            packed = [file.name for file in files if file.suffix.lower() == _COMPRESSED]
            advice = f": decompress {packed[0]} first (zstd -d)" if packed else ""
            raise InvalidArgument(f"{path} has a {_METADATA} and no .db3 or .mcap{advice}")
        return cls._of_files((path / _METADATA, *found), topic)

    @classmethod
    def _of_files(cls, files: Sequence[Path], topic: str | None) -> "CaptureFiles":
        return cls(tuple(files), tuple(file.stat().st_size for file in files), topic)

    def part(self, begin: int, size_bytes: int) -> bytes:
        """Return `size_bytes` bytes from `begin`, fewer at the end."""
        found = b""
        for file, size in zip(self.files, self.sizes, strict=True):
            if begin < size and len(found) < size_bytes:
                with file.open("rb") as opened:
                    opened.seek(begin)
                    found += opened.read(min(size_bytes - len(found), size - begin))
            begin = max(begin - size, 0)
        return found


def _has_metadata(folder: Path) -> bool:
    """Return whether a folder has the metadata of a recording: other files have their name too."""
    if not (folder / _METADATA).is_file():
        return False
    try:
        with (folder / _METADATA).open("rb") as file:
            return _INFORMATION in file.read(_INFORMATION_WITHIN_BYTES)
    except OSError:  # who sends it says why not
        return True
