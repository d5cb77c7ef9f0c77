"""New HDF5 files, written with h5py, which reads no existing file and sees no disk error.

It is imported where a file is made: a process that only reads does without its 12 MB.
"""

import io
import math
import os
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from storage.durable_file import DurableFile, reading_back
from storage.errors import CorruptFile
from storage.hdf5.chunk_index import ChunkAddress
from storage.hdf5.dataset import ChunkedDataset
from storage.hdf5.file import Hdf5File
from storage.hdf5.source import FileSource

if TYPE_CHECKING:
    import h5py

_LIBVER = "v110"  # checksums of all structures, and a fixed array that lists the chunks
_BLOCK_BYTES = 2**22  # read back at once


def hdf5_in_memory(
    arrays: Mapping[str, Sequence[NDArray[Any]]], attributes: Mapping[str, str | int]
) -> bytes:
    """Return the bytes of a file of contiguous arrays.

    Args:
        arrays: Each in one or more pieces of its first axis.
        attributes: Attributes of the root.
    """
    import h5py

    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=_LIBVER) as file:
        for name, (first, *others) in arrays.items():
            if not others:
                file.create_dataset(name, data=first)
                continue
            rows = len(first) + sum(map(len, others))
            dataset = file.create_dataset(name, (rows, *first.shape[1:]), first.dtype)
            start = 0
            for piece in (first, *others):
                dataset[start : start + len(piece)] = piece
                start += len(piece)
        file.attrs.update(attributes)
    return buffer.getvalue()  # no copy


@contextmanager
def hdf5_on_disk(path: Path) -> Iterator["FileWriter"]:
    """Yield a writer of a new file; at the end, fsync the file and read it back.

    Raises:
        FileExistsError: If there is a file.
        OSError: If it cannot be written, or is read back as something else.
    """
    import h5py

    with DurableFile(path) as disk:
        quiet = _QuietFile(disk)
        try:
            with h5py.File(quiet, "w", libver=_LIBVER) as file:
                writer = FileWriter(path, file, quiet)
                yield writer
        except Exception as error:
            if quiet.error not in {None, error}:
                raise quiet.error from error
            raise
        quiet.raise_error()
        disk.sync()
    with reading_back():
        writer.require_same()


class _QuietFile:
    """A file object that does not raise disk errors but stores the first one.

    After some failed writes, HDF5 ends the process. So from the first error on nothing is written,
    the library sees success, and we raise the error.

    Attributes:
        error: The first error.
    """

    def __init__(self, disk: DurableFile) -> None:
        self.error: OSError | None = None
        self._disk = disk
        self._at = self._size = 0

    def raise_error(self) -> None:
        """Raise the first error, if there was one."""
        if self.error is not None:
            raise self.error

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Set the position, counted from the beginning or the end."""
        self._at = offset + (self._size if whence == os.SEEK_END else 0)
        return self._at

    def tell(self) -> int:
        """Return the position."""
        return self._at

    def write(self, content: bytearray) -> int:
        """Write bytes."""
        self._unless_failed(self._disk.write, self._at, content)
        self._at += len(content)
        self._size = max(self._size, self._at)
        return len(content)

    def truncate(self, size: int) -> int:
        """Set the file's length."""
        self._unless_failed(self._disk.truncate, size)
        self._size = size
        return size

    def read(self, count: int) -> bytes:
        """Return bytes that were written here: the library reads back some of its own."""
        content = self._unless_failed(self._disk.read, self._at, count) or b""
        self._at += count
        return content.ljust(count, b"\0")

    def flush(self) -> None:
        """Do nothing: nothing is buffered here."""

    def _unless_failed(self, call: Callable[..., bytes | None], *args: object) -> bytes | None:
        if self.error is None:
            try:
                return call(*args)
            except OSError as error:
                self.error = error
        return None


@dataclass
class _Sum:
    """What identifies an array: kind, shape and a CRC-32 of its numbers, row by row."""

    dtype: np.dtype[Any]
    row_shape: tuple[int, ...]
    rows: int = 0
    crc: int = 0

    def add(self, rows: NDArray[Any]) -> None:
        """Add rows to the CRC-32."""
        self.rows += len(rows)
        if rows.size:
            self.crc = zlib.crc32(np.ascontiguousarray(rows).data, self.crc)


class FileWriter:
    """Adds arrays with checksums, and attributes, to the root of a new file."""

    def __init__(self, path: Path, file: "h5py.File", quiet: _QuietFile) -> None:
        self._path, self._file, self._quiet = path, file, quiet
        self._written: dict[str, _Sum] = {}
        self._attributes: dict[str, str | int] = {}

    def add(self, name: str, array: NDArray[Any]) -> None:
        """Write a small array as one chunk with a checksum; an empty one has none."""
        checked = bool(array.size)
        chunks = array.shape if checked else None
        self._file.create_dataset(name, data=array, chunks=chunks, fletcher32=checked)
        self._quiet.raise_error()
        self._written[name] = _Sum(array.dtype, array.shape[1:])
        self._written[name].add(array)

    def add_rows(self, name: str, dtype: str, most: int, chunk_shape: tuple[int, ...]) -> "Rows":
        """Return a writer of an array, row by row.

        Args:
            name: The array's name.
            dtype: The kind of its numbers.
            most: Maximum number of rows.
            chunk_shape: Shape of each chunk; its rows span all axes but the first.
        """
        shape = (most, *chunk_shape[1:])
        dataset = self._file.create_dataset(
            name,
            shape=shape,
            maxshape=shape,
            chunks=chunk_shape,
            dtype=dtype,
            fletcher32=True,
            # The cache holds a chunk: else the library reads it again for each of its rows.
            rdcc_nbytes=math.prod(chunk_shape) * np.dtype(dtype).itemsize,
        )
        self._written[name] = _Sum(np.dtype(dtype), shape[1:])
        return Rows(self._path, dataset, self._quiet, self._written[name])

    def add_attributes(self, attributes: Mapping[str, str | int]) -> None:
        """Write attributes."""
        self._file.attrs.update(attributes)
        self._quiet.raise_error()
        self._attributes.update(attributes)

    def require_same(self) -> None:
        """Read the file without the library, and compare it with what was written.

        Raises:
            CorruptFile: If it cannot be read, or holds something else.
        """
        with Hdf5File(FileSource(self._path)) as file:
            for name, written in self._written.items():
                dataset = file.dataset(name)
                array = _Sum(dataset.dtype, dataset.shape[1:])
                block = max(1, _BLOCK_BYTES * dataset.shape[0] // max(1, dataset.size_bytes))
                for start in range(0, dataset.shape[0], block):
                    array.add(dataset.rows(start, start + block))
                if array != written:
                    raise CorruptFile(f"{name} is {array}, {written} was written")
            for name, value in self._attributes.items():
                read, length = file.attributes, len(str(value).encode())
                found = read.text(name, length) if isinstance(value, str) else read.whole(name)
                if found != value:
                    raise CorruptFile(f"its attribute {name} is not what was written")


class Rows:
    """An array that is written row by row: `rows[i] = row`, in the order of i."""

    def __init__(
        self, path: Path, dataset: "h5py.Dataset", quiet: _QuietFile, written: _Sum
    ) -> None:
        self._path, self._dataset, self._quiet, self._written = path, dataset, quiet, written

    def __len__(self) -> int:
        return self._written.rows

    def __setitem__(self, row: int, numbers: NDArray[Any]) -> None:
        """Add the next row.

        Raises:
            ValueError: If it is not the next row.
            OSError: If something before it could not be written.
        """
        if row != len(self):
            raise ValueError(f"row {row} was given, the next is {len(self)}")
        array = np.asarray(numbers, self._written.dtype)
        self._dataset[row] = array
        self._quiet.raise_error()
        self._written.add(array[np.newaxis])

    def end(self) -> None:
        """Truncate the array to the rows that were written."""
        self._dataset.resize(len(self), axis=0)
        self._quiet.raise_error()

    @contextmanager
    def readable(self) -> Iterator[ChunkedDataset]:
        """Yield what was written, read without the library while it has the file open.

        Raises:
            OSError: If it cannot be written, or is read back as something else.
        """
        self._dataset.flush()
        self._quiet.raise_error()
        chunks: list[ChunkAddress] = []
        self._dataset.id.chunk_iter(
            lambda chunk: chunks.append(ChunkAddress(chunk.byte_offset, chunk.size, 0))
        )
        with reading_back(), FileSource(self._path) as source:
            yield ChunkedDataset(
                source,
                self._dataset.name,
                self._written.dtype,
                self._dataset.shape,
                self._dataset.chunks[0],
                tuple(chunks),
            )
