"""A new file, written with plain writes whose errors are seen, synced, and read back."""

import errno
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

from storage.errors import CorruptFile

__all__ = ["DurableFile", "reading_back"]

_PIECE_BYTES = 2**20  # written at once, and compared at once


class DurableFile:
    """A file that does not exist yet, readable by this user only.

    Args:
        path: Where; a file that is there is an error.

    Raises:
        FileExistsError: If there is one.
        OSError: If the disk refuses it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        self._waiting = bytearray()
        self._waits_at = 0
        self._written: list[tuple[int, int, int]] = []  # where, bytes, CRC-32

    def write(self, at: int, content: bytes | memoryview) -> None:
        """Put bytes at a place where none were put before; short runs wait for more.

        Raises:
            OSError: If the disk refuses them, or those that waited.
        """
        if self._waiting and at != self._waits_at + len(self._waiting):
            self.flush()
        if not self._waiting:
            self._waits_at = at
        if len(self._waiting) + len(content) < _PIECE_BYTES:
            self._waiting += content
            return
        self.flush()
        self._write(at, memoryview(content))

    def flush(self) -> None:
        """Write what waits.

        Raises:
            OSError: If the disk refuses it.
        """
        if self._waiting:
            content, self._waiting = self._waiting, bytearray()
            self._write(self._waits_at, memoryview(content))

    def settle(self) -> None:
        """Wait until all is on disk, and read it back.

        Raises:
            OSError: If the disk refuses it, or gives back other bytes than were written.
        """
        self.flush()
        os.fsync(self._descriptor)
        for at, count, checksum in self._written:
            if zlib.crc32(self._read(at, count)) != checksum:
                raise OSError(
                    errno.EIO, f"other bytes came back than were written at {at}", str(self._path)
                )

    def close(self) -> None:
        """Close it, finished or not."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, at: int, content: memoryview) -> None:
        for begin in range(0, len(content), _PIECE_BYTES):
            piece = content[begin : begin + _PIECE_BYTES]
            self._written.append((at + begin, len(piece), zlib.crc32(piece)))
            done = 0
            while done < len(piece):
                count = os.pwrite(self._descriptor, piece[done:], at + begin + done)
                if not count:
                    raise OSError(errno.EIO, "nothing was written", str(self._path))
                done += count

    def _read(self, at: int, count: int) -> bytes:
        content = b""
        while len(content) < count:
            more = os.pread(self._descriptor, count - len(content), at + len(content))
            if not more:
                break
            content += more
        return content


@contextmanager
def reading_back() -> Iterator[None]:
    """Raise what is wrong with a file that was written just now as the disk's error that it is.

    Raises:
        OSError: If the file is not what was written.
    """
    try:
        yield
    except CorruptFile as error:
        raise OSError(errno.EIO, f"what was written cannot be read back: {error}") from error
