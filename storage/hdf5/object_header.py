"""Object headers: the messages that say what a group or a dataset is."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from storage.errors import CorruptFile
from storage.hdf5.source import Fields, Source

_CONTINUATION = 0x10
_MOST_BLOCKS = 64
_MOST_MESSAGES = 256


class Message:
    """Types of messages, by their number in the format's specification."""

    DATASPACE = 0x01
    LINK_INFO = 0x02
    DATATYPE = 0x03
    LINK = 0x06
    EXTERNAL_FILES = 0x07
    LAYOUT = 0x08
    FILTERS = 0x0B
    ATTRIBUTE = 0x0C
    SYMBOL_TABLE = 0x11
    ATTRIBUTE_INFO = 0x15


_IGNORED = {
    0x00,  # nothing
    0x04,  # fill values: we write every number
    0x05,
    0x0A,  # when links are stored elsewhere
    0x0E,  # times
    0x12,
    0x13,  # sizes of B-tree nodes
    0x16,  # how many links refer to this object
}
_KNOWN = {value for name, value in vars(Message).items() if name.isupper()} | _IGNORED
_SHARED = 2
_MESSAGE = struct.Struct("<BHB")


@dataclass(frozen=True)
class Messages:
    """The messages of one object.

    Attributes:
        name: The object, for errors.
        all: Pairs of type and content, without the types that are ignored.
    """

    name: str
    all: tuple[tuple[int, bytes], ...]

    def of(self, kind: int) -> Iterator[Fields]:
        """Yield the messages of a type."""
        for found, content in self.all:
            if found == kind:
                yield Fields(content, self.name)

    def optional(self, kind: int) -> Fields | None:
        """Return the message of a type, `None` if there is none.

        Raises:
            CorruptFile: If there are several.
        """
        found = list(self.of(kind))
        if len(found) > 1:
            raise CorruptFile(f"{self.name} has {len(found)} messages {kind:#x}, wanted one")
        return found[0] if found else None

    def one(self, kind: int) -> Fields:
        """Return the only message of a type.

        Raises:
            CorruptFile: If there is none, or several.
        """
        if (found := self.optional(kind)) is None:
            raise CorruptFile(f"{self.name} has no message {kind:#x}")
        return found


def read_messages(source: Source, at: int, name: str) -> Messages:
    """Read the header of an object, of version 1 or 2, with its continuations.

    Raises:
        CorruptFile: If it is damaged, or uses what these files never do.
    """
    start = source.structure(at, 16, f"the header of {name}")
    if start.content[:4] == b"OHDR":
        read = _version_2(source, at, start)
    elif start.content[:2] == b"\x01\x00":
        read = _version_1(source, at, start)
    else:
        raise CorruptFile(f"{name} has no header at byte {at}")
    kept = []
    for count, (kind, flags, content) in enumerate(read):
        if count == _MOST_MESSAGES:
            raise CorruptFile(f"{name} has more than {_MOST_MESSAGES} messages")
        if kind not in _KNOWN:
            raise CorruptFile(f"{name} has a message {kind:#x}, which is not read here")
        if kind in _IGNORED:
            continue
        if flags & _SHARED:
            raise CorruptFile(f"{name} shares its message {kind:#x} with others")
        kept.append((kind, content))
    return Messages(name, tuple(kept))


def _version_1(source: Source, at: int, start: Fields) -> Iterator[tuple[int, int, bytes]]:
    start.take(2)
    count, _, size = start.unsigned(2), start.unsigned(4), start.unsigned(4)
    blocks = [(at + 16, size)]
    visited = 0
    while blocks:
        visited += 1
        block = source.structure(*blocks.pop(0), start.name)
        while count and block.left >= 8:
            count -= 1
            kind, size, flags = block.unsigned(2), block.unsigned(2), block.unsigned(1)
            block.take(3)
            content = block.take(size)
            if kind == _CONTINUATION:
                blocks.append(_continued(content, start.name, visited + len(blocks)))
            else:
                yield kind, flags, content
    if count:
        raise CorruptFile(f"{start.name} lacks {count} of its messages")


def _version_2(source: Source, at: int, start: Fields) -> Iterator[tuple[int, int, bytes]]:
    start.take(4)
    start.expect(b"\x02", "its version")
    flags = start.unsigned(1)
    if flags & 0xC0:
        raise CorruptFile(f"{start.name} has unknown flags {flags:#x}")
    prefix = 6 + (16 if flags & 0x20 else 0) + (4 if flags & 0x10 else 0)
    width = 1 << (flags & 3)
    size = source.structure(at + prefix, width, start.name).unsigned(width)
    prefix += width
    blocks = [(at, prefix, prefix + size + 4)]
    visited = 0
    while blocks:
        visited += 1
        at, prefix, length = blocks.pop(0)
        block = source.checked(at, length, start.name)
        if visited > 1:
            block.expect(b"OCHK", "a continuation's signature")
        else:
            block.take(prefix)
        tracked = 2 if flags & 4 else 0
        while block.left >= 4 + 4 + tracked:  # less is a gap
            kind, size, message_flags = _MESSAGE.unpack(block.take(4))
            block.take(tracked)
            if size > block.left - 4:
                raise CorruptFile(f"{start.name}: a message is cut off")
            content = block.take(size)
            if kind == _CONTINUATION:
                place, length = _continued(content, start.name, visited + len(blocks))
                blocks.append((place, 4, length))
            else:
                yield kind, message_flags, content


def _continued(content: bytes, name: str, so_far: int) -> tuple[int, int]:
    if so_far >= _MOST_BLOCKS:
        raise CorruptFile(f"{name} is in more than {_MOST_BLOCKS} pieces")
    fields = Fields(content, name)
    return fields.unsigned(8), fields.unsigned(8)
