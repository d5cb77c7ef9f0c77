"""Files of arrays in their root, written without the HDF5 library, front to back."""

import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from storage.hdf5.checksums import fletcher32, lookup3
from storage.hdf5.chunk_index import ChunkAddress
from storage.hdf5.kinds import CODES, TEXT
from storage.hdf5.links import MOST_LINKS
from storage.hdf5.object_header import Message
from storage.hdf5.source import UNDEFINED

__all__ = ["ChunkWriter", "Hdf5Writer", "Sink"]

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_SUPERBLOCK_BYTES = 48
_PAGE_BITS = 10  # as HDF5 does: 1,024 addresses of chunks in a page
_FILL_VALUE = 0x05
_GROUP_INFO = 0x0A
_LEAST_COLLECTION = 4096  # HDF5 refuses a smaller one


class Sink(Protocol):
    """Where bytes go; what it raises is raised here, and nothing was lost before that."""

    def write(self, at: int, content: bytes | memoryview) -> None:
        """Put bytes at a place."""


class Hdf5Writer:
    """Writes arrays one after another, then the structures that name them.

    The file is none until `finish` writes its first bytes, so that half a file is never read.

    Args:
        sink: Where the bytes go.
    """

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._end = _SUPERBLOCK_BYTES
        self._headers: dict[str, list[bytes]] = {}

    def add(
        self,
        name: str,
        dtype: str,
        shape: tuple[int, ...],
        pieces: Iterable[NDArray[Any]],
    ) -> None:
        """Write a contiguous array that comes in pieces of its first axis.

        Args:
            name: Its name.
            dtype: The kind of its numbers, a key of `CODES`.
            shape: Of the whole.
            pieces: Arrays whose numbers make up the whole.
        """
        self._align()
        at, size = self._end, 0
        for piece in pieces:
            numbers = np.ascontiguousarray(piece, dtype)
            if numbers.size:
                self._append(numbers.reshape(-1).view(np.uint8).data)
                size += numbers.nbytes
        if size != int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize:
            raise ValueError(f"{name}: {size} bytes came for shape {shape} of {dtype}")
        layout = struct.pack("<BBQQ", 3, 1, at if size else UNDEFINED, size)
        self._describe(name, dtype, shape, layout, _message(_FILL_VALUE, b"\x03\x0a"))

    def chunked(self, name: str, dtype: str, chunk_shape: tuple[int, ...]) -> "ChunkWriter":
        """Return what writes an array in chunks with checksums; it is ended before `finish`.

        Args:
            name: Its name.
            dtype: The kind of its numbers, a key of `CODES`.
            chunk_shape: Of each chunk; its rows span all axes but the first.
        """
        return ChunkWriter(self, name, dtype, chunk_shape)

    def finish(self, attributes: Mapping[str, str | int]) -> None:
        """Write the structures, and the root's attributes.

        Raises:
            ValueError: If there are more arrays than the reader takes.
        """
        if len(self._headers) > MOST_LINKS:
            raise ValueError(f"{len(self._headers)} arrays, at most {MOST_LINKS}")
        links = [
            _message(Message.LINK, _link(name, self._append(_object(messages))))
            for name, messages in self._headers.items()
        ]
        texts = [value.encode() for value in attributes.values() if isinstance(value, str)]
        self._align()
        texts_at = self._append(_collection(texts))
        numbers = iter(range(1, len(texts) + 1))
        root = _object(
            [
                _message(Message.LINK_INFO, struct.pack("<BBQQ", 0, 0, UNDEFINED, UNDEFINED)),
                # Links stay in the header up to the most that are read, also if a tool adds one.
                _message(_GROUP_INFO, struct.pack("<BBHH", 0, 1, MOST_LINKS, 0)),
                *links,
                *(
                    _message(
                        Message.ATTRIBUTE,
                        _text_attribute(name, len(value.encode()), texts_at, next(numbers))
                        if isinstance(value, str)
                        else _whole_attribute(name, value),
                    )
                    for name, value in attributes.items()
                ),
            ]
        )
        root_at = self._append(root)
        block = _SIGNATURE + struct.pack("<BBBBQQQQ", 3, 8, 8, 0, 0, UNDEFINED, self._end, root_at)
        self._sink.write(0, _summed(block))

    def _describe(
        self, name: str, dtype: str, shape: tuple[int, ...], layout: bytes, *more: bytes
    ) -> None:
        if name in self._headers:
            raise ValueError(f"{name} is written twice")
        axes = struct.pack(f"<BBBB{len(shape)}Q", 2, len(shape), 0, 1, *shape)
        self._headers[name] = [
            _message(Message.DATASPACE, axes),
            _message(Message.DATATYPE, CODES[dtype]),
            *more,
            _message(Message.LAYOUT, layout),
        ]

    def _align(self) -> None:
        if gap := -self._end % 8:
            self._append(bytes(gap))

    def _append(self, content: bytes | memoryview) -> int:
        """Write bytes at the end and return where that was."""
        at = self._end
        self._sink.write(at, content)
        self._end += len(content)
        return at


class ChunkWriter:
    """An array that is written chunk after chunk, row after row; HDF5's fixed array lists them.

    A row is `writer[i] = row`, with i counting up; only the rows of one chunk are in memory.
    """

    def __init__(
        self, writer: "Hdf5Writer", name: str, dtype: str, chunk_shape: tuple[int, ...]
    ) -> None:
        self._writer, self._name, self._dtype = writer, name, dtype
        self._chunk = np.zeros(chunk_shape, dtype)
        self._rows = 0
        self._written: list[ChunkAddress] = []

    def __len__(self) -> int:
        return self._rows

    def __setitem__(self, row: int, numbers: NDArray[Any]) -> None:
        """Add the next row.

        Raises:
            ValueError: If it is not the next, or has another shape.
        """
        if row != self._rows:
            raise ValueError(f"{self._name}: row {row} came, the next is {self._rows}")
        self._chunk[row % len(self._chunk)] = numbers
        self._rows += 1
        if self._rows % len(self._chunk) == 0:
            self._flush()

    @property
    def chunk_shape(self) -> tuple[int, ...]:
        """The shape of a chunk."""
        return self._chunk.shape

    def end(self) -> tuple[ChunkAddress, ...]:
        """Write what is left and the list of the chunks; return where they are."""
        if used := self._rows % len(self._chunk):
            self._chunk[used:] = 0
            self._flush()
        shape = (self._rows, *self._chunk.shape[1:])
        lengths = (*self._chunk.shape, self._chunk.itemsize)
        width = (max(lengths).bit_length() + 7) // 8  # HDF5 refuses more bytes than it takes
        layout = b"".join(
            (
                struct.pack("<BBBBB", 4, 2, 0, len(lengths), width),
                *(length.to_bytes(width, "little") for length in lengths),
                struct.pack("<BBQ", 3, _PAGE_BITS, self._index() if self._written else UNDEFINED),
            )
        )
        self._writer._describe(
            self._name,
            self._dtype,
            shape,
            layout,
            _message(_FILL_VALUE, b"\x03\x0b"),
            _message(Message.FILTERS, struct.pack("<BBHHH", 2, 1, 3, 0, 0)),
        )
        return tuple(self._written)

    def _flush(self) -> None:
        content = self._chunk.reshape(-1).view(np.uint8).data
        at = self._writer._append(content)
        self._writer._append(struct.pack("<I", fletcher32(content)))
        self._written.append(ChunkAddress(at, len(content) + 4, 0))

    def _index(self) -> int:
        """Write the fixed array and return where its header is."""
        writer, width = self._writer, _size_bytes(self._chunk.nbytes)
        entries = [
            struct.pack("<Q", chunk.at) + chunk.size.to_bytes(width, "little") + bytes(4)
            for chunk in self._written
        ]
        at = writer._end
        block_at = at + 28
        header = struct.pack(
            "<4sBBBBQQ", b"FAHD", 0, 1, len(entries[0]), _PAGE_BITS, len(entries), block_at
        )
        begin = struct.pack("<4sBBQ", b"FADB", 0, 1, at)
        page = 1 << _PAGE_BITS
        if len(entries) <= page:
            parts = [begin + b"".join(entries)]
        else:
            pages = [b"".join(entries[i : i + page]) for i in range(0, len(entries), page)]
            present = int("1" * len(pages), 2) << (-len(pages) % 8)
            parts = [begin + present.to_bytes((len(pages) + 7) // 8, "big"), *pages]
        writer._append(b"".join(map(_summed, [header, *parts])))
        return at


def _size_bytes(chunk_bytes: int) -> int:
    """Return how many bytes tell a chunk's size in an index: the library takes that for granted."""
    return min(8, 1 + (chunk_bytes.bit_length() - 1 + 8) // 8)


def _summed(content: bytes) -> bytes:
    return content + struct.pack("<I", lookup3(content))


def _message(kind: int, content: bytes) -> bytes:
    return struct.pack("<BHB", kind, len(content), 0) + content


def _object(messages: Iterable[bytes]) -> bytes:
    content = b"".join(messages)
    return _summed(struct.pack("<4sBBI", b"OHDR", 2, 2, len(content)) + content)


def _link(name: str, address: int) -> bytes:
    told = name.encode()
    return struct.pack("<BBB", 1, 0, len(told)) + told + struct.pack("<Q", address)


def _collection(texts: Sequence[bytes]) -> bytes:
    """Return HDF5's global heap of the texts, numbered from 1; what is left of it is object 0."""
    objects = b"".join(
        struct.pack("<HHIQ", number, 1, 0, len(text)) + text + bytes(-len(text) % 8)
        for number, text in enumerate(texts, start=1)
    )
    size = max(_LEAST_COLLECTION, 16 + len(objects) + 16)
    left = size - 16 - len(objects)
    free = struct.pack("<HHIQ", 0, 0, 0, left) + bytes(left - 16)
    return struct.pack("<4sBxxxQ", b"GCOL", 1, size) + objects + free


def _text_attribute(name: str, length: int, at: int, number: int) -> bytes:
    return _attribute(name, TEXT, struct.pack("<IQI", length, at, number))


def _whole_attribute(name: str, value: int) -> bytes:
    return _attribute(name, CODES["<i8"], struct.pack("<q", value))


def _attribute(name: str, kind: bytes, value: bytes) -> bytes:
    told, scalar = name.encode() + b"\0", bytes([2, 0, 0, 0])
    sizes = struct.pack("<HHH", len(told), len(kind), len(scalar))
    return bytes([3, 0]) + sizes + b"\1" + told + kind + scalar + value
