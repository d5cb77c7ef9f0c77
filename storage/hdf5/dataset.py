"""Arrays of numbers in a file, contiguous or in chunks with checksums."""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.errors import CorruptFile
from storage.hdf5.checksums import fletcher32
from storage.hdf5.chunk_index import ChunkAddress, read_fixed_array
from storage.hdf5.kinds import dtype_of, shape_of
from storage.hdf5.object_header import Message, Messages
from storage.hdf5.source import UNDEFINED, Fields, Source

__all__ = ["ChunkedDataset", "ContiguousDataset", "Dataset", "open_dataset"]

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
        return _product(self.shape) * self.dtype.itemsize

    def read(self) -> NDArray[Any]:
        """Return all numbers.

        Raises:
            CorruptFile: If they are not where they should be, or a checksum does not fit.
        """
        return self.rows(0, self.shape[0]) if self.shape else self._scalar()

    def rows(self, start: int, stop: int) -> NDArray[Any]:
        """Return the numbers of rows `start` up to `stop` of the first axis.

        Raises:
            CorruptFile: If they are not where they should be, or a checksum does not fit.
        """
        raise NotImplementedError

    def _scalar(self) -> NDArray[Any]:
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class ContiguousDataset(Dataset):
    """An array whose numbers lie one after another, row-major.

    Attributes:
        at: The address of the first, 0 if there are none.
    """

    at: int

    def rows(self, start: int, stop: int) -> NDArray[Any]:
        """Return the numbers of rows `start` up to `stop` of the first axis."""
        start, stop, _ = slice(start, stop).indices(self.shape[0])
        row_bytes = _product(self.shape[1:]) * self.dtype.itemsize
        shape = (max(0, stop - start), *self.shape[1:])
        return self.source.array(self.at + start * row_bytes, self.dtype, shape, self.name)

    def _scalar(self) -> NDArray[Any]:
        return self.source.array(self.at, self.dtype, (), self.name)


@dataclass(frozen=True, eq=False)
class ChunkedDataset(Dataset):
    """An array in chunks of one shape, each with a Fletcher checksum.

    Attributes:
        chunk_shape: The shape of a chunk; those at an end are filled up.
        chunks: Where they lie, in row-major order of the grid of chunks.
    """

    chunk_shape: tuple[int, ...]
    chunks: tuple[ChunkAddress, ...]

    def rows(self, start: int, stop: int) -> NDArray[Any]:
        """Return the numbers of rows `start` up to `stop` of the first axis."""
        start, stop, _ = slice(start, stop).indices(self.shape[0])
        stop = max(start, stop)
        rows = np.empty((stop - start, *self.shape[1:]), self.dtype)
        grid = _grid(self.shape, self.chunk_shape)
        length = self.chunk_shape[0]
        for first in range(start // length, -(-stop // length) if stop > start else 0):
            for others in product(*(range(count) for count in grid[1:])):
                number = int(np.ravel_multi_index((first, *others), grid)) if grid[1:] else first
                chunk = self._chunk(number)
                begin = first * length
                into = (
                    slice(max(0, begin - start), min(stop, begin + length) - start),
                    *(
                        slice(place * size, min((place + 1) * size, whole))
                        for place, size, whole in zip(
                            others, self.chunk_shape[1:], self.shape[1:], strict=True
                        )
                    ),
                )
                out_of = (
                    slice(max(0, start - begin), min(stop - begin, length)),
                    *(slice(0, part.stop - part.start) for part in into[1:]),
                )
                rows[into] = chunk[out_of]
        return rows

    def _scalar(self) -> NDArray[Any]:
        raise CorruptFile(f"{self.name} is one number in chunks")

    def _chunk(self, number: int) -> NDArray[Any]:
        count = _product(self.chunk_shape) * self.dtype.itemsize
        place = self.chunks[number]
        if place.at == UNDEFINED:
            raise CorruptFile(f"{self.name}: chunk {number} was never written")
        if place.mask or place.size != count + _CHECKSUM:
            raise CorruptFile(
                f"{self.name}: chunk {number} has {place.size} bytes, wanted {count + _CHECKSUM}"
            )
        raw = self.source.read(place.at, place.size, f"{self.name}: chunk {number}")
        if fletcher32(memoryview(raw)[:count]) != int.from_bytes(raw[count:], "little"):
            raise CorruptFile(f"{self.name}: the checksum of chunk {number} does not fit")
        return np.frombuffer(raw, self.dtype, _product(self.chunk_shape)).reshape(self.chunk_shape)


def open_dataset(source: Source, messages: Messages) -> Dataset:
    """Return the array that an object header describes; its numbers are not read yet.

    Raises:
        CorruptFile: If it is none, or one that is not read here; it says why.
    """
    name = messages.name
    if messages.optional(Message.LAYOUT) is None:
        raise CorruptFile(f"{name} is no plain array of numbers")
    shape = shape_of(messages.one(Message.DATASPACE))
    dtype = dtype_of(messages.one(Message.DATATYPE))
    layout = messages.one(Message.LAYOUT)
    version, kind = layout.unsigned(1), layout.unsigned(1)
    if kind == _VIRTUAL or messages.optional(Message.EXTERNAL_FILES) is not None:
        raise CorruptFile(f"{name} keeps its numbers in another file")
    filtered = _filtered(messages)
    if version not in {3, 4} or kind not in {_CONTIGUOUS, _CHUNKED}:
        raise CorruptFile(f"{name} has layout {kind} of version {version}, which is not read here")
    if kind == _CHUNKED:
        return _chunked(source, name, dtype, shape, layout, filtered=filtered, version=version)
    if filtered:
        raise CorruptFile(f"{name} is filtered and contiguous")
    at, size = layout.unsigned(8), layout.unsigned(8)
    count = _product(shape) * dtype.itemsize
    if at == UNDEFINED:
        at, size = 0, 0
    if count > size:
        raise CorruptFile(f"{name} has more numbers than the file")
    source.require(at, count, name)
    return ContiguousDataset(source, name, dtype, shape, at)


def _filtered(messages: Messages) -> bool:
    """Return whether an array has checksums; any other filter is refused."""
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
    chunk_shape = tuple(lengths)
    kind = layout.unsigned(1)
    grid = _grid(shape, chunk_shape) if all(chunk_shape) else ()
    if item != dtype.itemsize or not grid or flags & ~2:
        raise CorruptFile(f"{name} has chunks of shape {chunk_shape} with items of {item} bytes")
    wanted = _product(grid)
    size = _product(chunk_shape) * item + _CHECKSUM
    if wanted * size > source.size_bytes:
        raise CorruptFile(f"{name} has more numbers than the file")
    if kind == 1 and flags == 2 and wanted <= 1:
        size, mask = layout.unsigned(8), layout.unsigned(4)
        chunks = [ChunkAddress(layout.unsigned(8), size, mask)][:wanted]
    elif kind == 3 and not flags:
        layout.take(1)
        at = layout.unsigned(8)
        chunks = read_fixed_array(source, at, wanted, name) if wanted else []
    else:
        raise CorruptFile(f"{name} lists its chunks in a way ({kind}) that is not read here")
    for chunk in chunks:
        if chunk.at != UNDEFINED:
            source.require(chunk.at, chunk.size, f"a chunk of {name}")
    return ChunkedDataset(source, name, dtype, shape, chunk_shape, tuple(chunks))


def _grid(shape: tuple[int, ...], chunk_shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(-(-whole // part) for whole, part in zip(shape, chunk_shape, strict=True))


def _product(lengths: tuple[int, ...]) -> int:
    count = 1
    for length in lengths:
        count *= length
    return count
