"""Arrays of numbers in a file, contiguous or in chunks with checksums."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.errors import CorruptFile
from storage.hdf5.checksums import fletcher32
from storage.hdf5.chunk_index import ChunkAddress, read_fixed_array
from storage.hdf5.kinds import dtype_of, shape_of
from storage.hdf5.object_header import Message, Messages
from storage.hdf5.source import UNDEFINED, Fields, Source

_FLETCHER32 = 3
_CHECKSUM = 4
_CONTIGUOUS, _CHUNKED, _VIRTUAL = 1, 2, 3


@dataclass(frozen=True, eq=False)
class Dataset:
    """An array in a file.

    Attributes:
        source: The file.
        name: The array's name.
        dtype: The kind of its numbers.
        shape: The lengths of its axes.
    """

    source: Source
    name: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    @property
    def size_bytes(self) -> int:
        """How many bytes its numbers take."""
        return math.prod(self.shape) * self.dtype.itemsize

    def read(self) -> NDArray[Any]:
        """Return all numbers.

        Raises:
            CorruptFile: If they are not where they should be, or a checksum does not fit.
        """
        return self.rows(0, self.shape[0])

    def rows(self, start: int, stop: int) -> NDArray[Any]:
        """Return the numbers of rows `start` up to `stop` of the first axis.

        Raises:
            CorruptFile: If they are not where they should be, or a checksum does not fit.
        """
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class ContiguousDataset(Dataset):
    """An array whose numbers are contiguous, row-major.

    Attributes:
        at: Address of the first number, 0 if there are none.
    """

    at: int

    def rows(self, start: int, stop: int) -> NDArray[Any]:
        """Return the numbers of rows `start` up to `stop` of the first axis."""
        start, stop, _ = slice(start, stop).indices(self.shape[0])
        row_bytes = math.prod(self.shape[1:]) * self.dtype.itemsize
        shape = (max(0, stop - start), *self.shape[1:])
        return self.source.array(self.at + start * row_bytes, self.dtype, shape, self.name)

    def read(self) -> NDArray[Any]:
        """Return all numbers, or the only one."""
        return self.source.array(self.at, self.dtype, self.shape, self.name)

    def mapped(self) -> NDArray[Any]:
        """Return all numbers, of a large array in memory that processes share."""
        return self.source.mapped(self.at, self.dtype, self.shape, self.name)


@dataclass(frozen=True, eq=False)
class ChunkedDataset(Dataset):
    """An array in chunks of whole rows, each with a Fletcher checksum.

    Attributes:
        chunk_rows: Number of rows in a chunk; the last chunk is padded.
        chunks: The chunks' addresses, in the order of their rows.
    """

    chunk_rows: int
    chunks: tuple[ChunkAddress, ...]

    def rows(self, start: int, stop: int) -> NDArray[Any]:
        """Return the numbers of rows `start` up to `stop` of the first axis."""
        start, stop, _ = slice(start, stop).indices(self.shape[0])
        stop = max(start, stop)
        rows = np.empty((stop - start, *self.shape[1:]), self.dtype)
        if not rows.size:
            return rows
        length = self.chunk_rows
        for number in range(start // length, -(-stop // length)):
            begin = number * length
            target = rows[max(0, begin - start) : begin + length - start]
            if len(target) == length:
                self._load(number, target)
            else:
                chunk = np.empty((length, *self.shape[1:]), self.dtype)
                self._load(number, chunk)
                target[:] = chunk[max(0, start - begin) : stop - begin]
        return rows

    def _load(self, number: int, target: NDArray[Any]) -> None:
        """Read a whole chunk into `target` and check its checksum."""
        place, name = self.chunks[number], f"{self.name}: chunk {number}"
        if place.at == UNDEFINED:
            raise CorruptFile(f"{name} was never written")
        if place.mask or place.size != target.nbytes + _CHECKSUM:
            raise CorruptFile(f"{name} has {place.size} bytes, wanted {target.nbytes + _CHECKSUM}")
        content = target.reshape(-1).view(np.uint8)
        self.source.read_into(place.at, content.data, name)
        checksum = self.source.read(place.at + target.nbytes, _CHECKSUM, name)
        if fletcher32(content) != int.from_bytes(checksum, "little"):
            raise CorruptFile(f"{self.name}: the checksum of chunk {number} does not fit")


def open_dataset(source: Source, messages: Messages, *, contiguous: bool) -> Dataset:
    """Return the array that an object header describes; its numbers are not read yet.

    Args:
        source: The file.
        messages: The header's messages.
        contiguous: Reject chunks, before the list of them is read.

    Raises:
        CorruptFile: If it is no array, or one that is not supported; the message says why.
    """
    name = messages.name
    if (layout := messages.optional(Message.LAYOUT)) is None:
        raise CorruptFile(f"{name} is no plain array of numbers")
    shape = shape_of(messages.one(Message.DATASPACE))
    dtype = dtype_of(messages.one(Message.DATATYPE).content, name)
    version, kind = layout.unsigned(1), layout.unsigned(1)
    if kind == _VIRTUAL or messages.optional(Message.EXTERNAL_FILES) is not None:
        raise CorruptFile(f"{name} keeps its numbers in another file")
    filtered = _filtered(messages)
    if version not in {3, 4} or kind not in {_CONTIGUOUS, _CHUNKED}:
        raise CorruptFile(f"{name} has layout {kind} of version {version}, which is not read here")
    if kind == _CHUNKED:
        if contiguous:
            what = "filtered" if filtered else "chunked"
            raise CorruptFile(f"{name} is {what}; its numbers must be contiguous")
        return _chunked(source, name, dtype, shape, layout, filtered=filtered, version=version)
    if filtered:
        raise CorruptFile(f"{name} is filtered and contiguous")
    at, size = layout.unsigned(8), layout.unsigned(8)
    count = math.prod(shape) * dtype.itemsize
    if at == UNDEFINED:
        at, size = 0, 0
    if count > size:
        raise CorruptFile(f"{name} has more numbers than the file")
    source.require(at, count, name)
    return ContiguousDataset(source, name, dtype, shape, at)


def _filtered(messages: Messages) -> bool:
    """Return whether an array has checksums; any other filter is rejected."""
    filters = messages.optional(Message.FILTERS)
    if filters is None:
        return False
    version, count = filters.unsigned(1), filters.unsigned(1)
    filters.take(6 if version == 1 else 0)
    number = filters.unsigned(2) if count == 1 and version in {1, 2} else None
    if number != _FLETCHER32:
        raise CorruptFile(f"{messages.name} is filtered otherwise than with checksums")
    return True


def _chunked(
    source: Source,
    name: str,
    dtype: np.dtype[Any],
    shape: tuple[int, ...],
    layout: Fields,
    *,
    filtered: bool,
    version: int,
) -> ChunkedDataset:
    if version != 4 or not filtered:
        what = "filtered" if filtered else "chunked"
        raise CorruptFile(f"{name} is {what} in a way that is not read here")
    flags, axes, width = layout.unsigned(1), layout.unsigned(1), layout.unsigned(1)
    if axes != len(shape) + 1 or not shape or not 0 < width <= 8:
        raise CorruptFile(f"{name} has {len(shape)} axes, its chunks {axes - 1}")
    *lengths, item = [layout.unsigned(width) for _ in range(axes)]
    kind = layout.unsigned(1)
    if item != dtype.itemsize or not lengths[0] or tuple(lengths[1:]) != shape[1:] or flags & ~2:
        raise CorruptFile(f"{name} has chunks of shape {lengths} with items of {item} bytes")
    count = -(-shape[0] // lengths[0])
    size = math.prod(lengths) * item + _CHECKSUM
    if count * size > source.size_bytes:
        raise CorruptFile(f"{name} has more numbers than the file")
    if kind == 1 and flags == 2 and count <= 1:
        size, mask = layout.unsigned(8), layout.unsigned(4)
        chunks = [ChunkAddress(layout.unsigned(8), size, mask)][:count]
    elif kind == 3 and not flags:
        layout.take(1)
        at = layout.unsigned(8)
        chunks = read_fixed_array(source, at, count, name) if count else []
    else:
        raise CorruptFile(f"{name} lists its chunks in a way ({kind}) that is not read here")
    for chunk in chunks:
        if chunk.at != UNDEFINED:
            source.require(chunk.at, chunk.size, f"a chunk of {name}")
    return ChunkedDataset(source, name, dtype, shape, lengths[0], tuple(chunks))
