"""A new file, written with `pwrite`, fsynced and read back; every error is raised."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from storage.closing import Closing
from storage.errors import CorruptFile

_BLOCK_BYTES = 2**20  # compared at once


class DurableFile(Closing):
    """A file that does not exist yet, readable by this user only.

    Args:
        path: The file's path; an existing file is an error.

    Raises:
        FileExistsError: If there is one.
        OSError: If it cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)

    def write(self, at: int, content: bytes | bytearray | memoryview) -> None:
        """Write bytes at a position.

        Raises:
            OSError: If they cannot be written.
        """
        left = memoryview(content).cast("B")
        while left:
            count = os.pwrite(self._descriptor, left, at)
            if not count:
                raise OSError(errno.EIO, "nothing was written", str(self._path))
            left, at = left[count:], at + count

    def read(self, at: int, count: int) -> bytes:
        """Return bytes at a position, fewer if the file ends before.

        Raises:
            OSError: If they cannot be read.
        """
        content = b""
        while more := os.pread(self._descriptor, count - len(content), at + len(content)):
            content += more
        return content

    def truncate(self, size_bytes: int) -> None:
        """Set its length.

        Raises:
            OSError: If it cannot be set.
        """
        os.ftruncate(self._descriptor, size_bytes)

    def sync(self) -> None:
        """Wait until all is on disk.

        Raises:
            OSError: If that fails.
        """
        os.fsync(self._descriptor)

    def close(self) -> None:
        """Close it, finished or not."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)


def write_whole(path: Path, content: bytes) -> None:
    """Write a new file, wait until it is on disk, and read it back.

    Raises:
        FileExistsError: If there is a file.
        OSError: If it cannot be written, or other bytes are read back.
    """
    with DurableFile(path) as file:
        file.write(0, content)
        file.sync()
        for at in range(0, len(content), _BLOCK_BYTES):
            block = content[at : at + _BLOCK_BYTES]
            if file.read(at, len(block)) != block:
                raise OSError(errno.EIO, f"other bytes were read back at {at}", str(path))


@contextmanager
def reading_back() -> Iterator[None]:
    """Raise the fault of a file that was just written as an error of the disk.

    Raises:
        OSError: If the file is not what was written.
    """
    try:
        yield
    except CorruptFile as error:
        raise OSError(errno.EIO, f"what was written cannot be read back: {error}") from error
