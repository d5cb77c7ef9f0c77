"""Bytes of a file, on a disk or in memory, and the fields of its structures, bounds checked."""

import math
import mmap
import os
import stat
from abc import abstractmethod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.closing import Closing
from storage.errors import CorruptFile
from storage.hdf5.checksums import lookup3

UNDEFINED = 2**64 - 1
"""The address of what was never allocated."""

_STRUCTURE_BYTES = 2**19  # ours take 10 kB; their checksums are computed in Python, 4 MB/s


_MAPPED_FROM_BYTES = 2**20  # a mapping keeps a descriptor open
_READ_ONCE_BYTES = 2**22


class Fields:
    """The fields of one structure, taken one after another.

    Args:
        content: The structure's bytes.
        name: What it is, for errors.
    """

    def __init__(self, content: bytes, name: str) -> None:
        self.content = content
        self.name = name
        self.at = 0

    @property
    def left(self) -> int:
        """The number of bytes not taken yet."""
        return len(self.content) - self.at

    def take(self, count: int) -> bytes:
        """Return the next bytes.

        Raises:
            CorruptFile: If the structure has fewer.
        """
        begin, end = self.at, self.at + count
        if not begin <= end <= len(self.content):
            raise CorruptFile(f"{self.name} is cut off: {count} bytes wanted, {self.left} left")
        self.at = end
        return self.content[begin:end]

    def check_sum(self) -> None:
        """Reject a structure whose last four bytes are not the checksum of those before them."""
        content = self.content
        if len(content) < 4 or lookup3(content[:-4]) != int.from_bytes(content[-4:], "little"):
            raise CorruptFile(f"the checksum of {self.name} does not fit")

    def unsigned(self, size: int) -> int:
        """Return the next little-endian unsigned number of `size` bytes."""
        return int.from_bytes(self.take(size), "little")

    def text(self, size: int, what: str) -> str:
        """Return the next bytes as UTF-8, without the zeros at their end.

        Raises:
            CorruptFile: If they are no UTF-8; `what` names them.
        """
        try:
            return self.take(size).rstrip(b"\0").decode()
        except UnicodeDecodeError as error:
            raise CorruptFile(f"{self.name}: {what} is no UTF-8") from error

    def expect(self, expected: bytes, what: str) -> None:
        """Reject a structure whose next bytes are not the expected ones."""
        if (found := self.take(len(expected))) != expected:
            raise CorruptFile(f"{self.name}: {what} is {found!r}, wanted {expected!r}")


class Source(Closing):
    """A file of known size that is read at any address.

    All structures together may take half a megabyte, and all text as much as the file: damage that
    makes structures refer to each other in a circle ends there.
    """

    def __init__(self, size_bytes: int) -> None:
        self.size_bytes = size_bytes
        self._structures_left = _STRUCTURE_BYTES
        self._text_left = size_bytes

    def structure(self, at: int, count: int, name: str) -> Fields:
        """Read a structure.

        Raises:
            CorruptFile: If it is not within the file, or too many were read.
        """
        self._structures_left -= count
        if self._structures_left < 0:
            raise CorruptFile(f"its structures take more than {_STRUCTURE_BYTES} bytes")
        return Fields(self.read(at, count, name), name)

    def checked(self, at: int, count: int, name: str) -> Fields:
        """Read a structure whose last four bytes are the checksum of those before them.

        Raises:
            CorruptFile: As in `structure`, or if the checksum does not fit.
        """
        fields = self.structure(at, count, name)
        fields.check_sum()
        return fields

    def text(self, at: int, count: int, name: str) -> Fields:
        """Read text; all of it together takes no more bytes than the file has."""
        self._text_left -= count
        if self._text_left < 0:
            raise CorruptFile("its text takes more bytes than the file has")
        return Fields(self.read(at, count, name), name)

    def require(self, at: int, count: int, name: str) -> None:
        """Reject an address range that is not within the file."""
        if not (0 <= at <= self.size_bytes and 0 <= count <= self.size_bytes - at):
            raise CorruptFile(f"{name}: {count} bytes at {at}, the file has {self.size_bytes}")

    def read(self, at: int, count: int, name: str) -> bytes:
        """Return bytes of the file.

        Raises:
            CorruptFile: If they are not within it, or cannot be read.
        """
        self.require(at, count, name)
        content = bytearray(count)
        self.read_into(at, memoryview(content), name)
        return bytes(content)

    def array(
        self, at: int, dtype: np.dtype[Any], shape: tuple[int, ...], name: str
    ) -> NDArray[Any]:
        """Return a contiguous array; it takes no more memory than the file has bytes.

        Raises:
            CorruptFile: If it is not within the file, or cannot be read.
        """
        count = dtype.itemsize * math.prod(shape)
        self.require(at, count, name)
        array = np.empty(shape, dtype)
        self.read_into(at, array.reshape(-1).view(np.uint8).data, name)
        return array

    def mapped(
        self, at: int, dtype: np.dtype[Any], shape: tuple[int, ...], name: str
    ) -> NDArray[Any]:
        """Return a contiguous array, in shared memory where that is possible and worth it.

        Raises:
            CorruptFile: If it is not within the file, or cannot be read.
        """
        return self.array(at, dtype, shape, name)

    def read_into(self, at: int, target: memoryview, name: str) -> None:
        """Fill `target` with bytes of the file.

        Raises:
            CorruptFile: If they are not within it, or cannot be read.
        """
        self.require(at, len(target), name)
        try:
            count = self._read_into(at, target)
        except OSError as error:
            raise CorruptFile(f"{name} cannot be read: {error}") from error
        if count != len(target):
            raise CorruptFile(f"{name} is cut off: the file became shorter")

    @abstractmethod
    def _read_into(self, at: int, target: memoryview) -> int:
        """Read bytes that are within the file into `target`; return how many were read."""


class BytesSource(Source):
    """A file in memory."""

    def __init__(self, content: bytes) -> None:
        super().__init__(len(content))
        self._content = content

    def close(self) -> None:
        """Nothing is open."""

    def _read_into(self, at: int, target: memoryview) -> int:
        target[:] = memoryview(self._content)[at : at + len(target)]
        return len(target)


class FileSource(Source):
    """A file on a disk, read with `preadv`, since a bad sector under `mmap` raises a signal.

    Large arrays are mapped after all of them could be read.

    Raises:
        FileNotFoundError: If there is no such file.
        CorruptFile: If it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor = -1
        try:
            self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            status = os.fstat(self._descriptor)
            if stat.S_ISDIR(status.st_mode):
                raise CorruptFile("it is a folder, wanted a file")
            super().__init__(status.st_size)
        except FileNotFoundError:
            raise
        except OSError as error:
            self.close()
            # Its text has the path, which a client need not know.
            raise CorruptFile(f"it cannot be read: {error.strerror}") from error

    @property
    def identity(self) -> tuple[int, ...]:
        """Changes when the file is replaced or written to."""
        status = os.fstat(self._descriptor)
        times_ns = status.st_mtime_ns, status.st_ctime_ns
        return status.st_dev, status.st_ino, status.st_size, *times_ns

    def mapped(
        self, at: int, dtype: np.dtype[Any], shape: tuple[int, ...], name: str
    ) -> NDArray[Any]:
        """Return a large array as pages of the file, read-only; a small one as `array` does.

        The pages stay those of this file when it is removed or another one takes its name.
        """
        count = dtype.itemsize * math.prod(shape)
        if count < _MAPPED_FROM_BYTES:
            return self.array(at, dtype, shape, name)
        self.require(at, count, name)
        block = bytearray(min(count, _READ_ONCE_BYTES))
        for start in range(0, count, len(block)):
            length = min(len(block), count - start)
            self.read_into(at + start, memoryview(block)[:length], name)
        before = at % mmap.ALLOCATIONGRANULARITY
        try:
            pages = mmap.mmap(
                self._descriptor, before + count, access=mmap.ACCESS_READ, offset=at - before
            )
        except (OSError, ValueError) as error:  # of a file that became shorter
            raise CorruptFile(f"{name} cannot be mapped: {error}") from error
        return np.frombuffer(pages, dtype, math.prod(shape), before).reshape(shape)

    def close(self) -> None:
        """Close the file."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def __del__(self) -> None:
        self.close()

    def _read_into(self, at: int, target: memoryview) -> int:
        done = 0
        while done < len(target):
            count = os.preadv(self._descriptor, [target[done:]], at + done)
            if not count:
                break
            done += count
        return done
