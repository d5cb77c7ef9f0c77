"""Attributes of the root: texts, and single whole numbers."""

import struct

import numpy as np

from storage.errors import CorruptFile
from storage.hdf5.kinds import shape_of, text_or_dtype
from storage.hdf5.object_header import Message, Messages
from storage.hdf5.source import UNDEFINED, Fields, Source

_MOST = 64


class Attributes:
    """The attributes of an object, looked up by name.

    Only an attribute that is looked up is interpreted: others may be of any kind.

    Raises:
        CorruptFile: If their list is damaged, too long, or stored apart from the object.
    """

    def __init__(self, source: Source, of: Messages) -> None:
        self._source = source
        self._found: dict[str, tuple[bytes, bytes, bytes]] = {}  # kind, shape and value by name
        self._texts: dict[int, dict[int, bytes]] = {}
        info = of.optional(Message.ATTRIBUTE_INFO)
        if info is not None:
            info.expect(b"\0", "the version of its attributes")
            flags = info.unsigned(1)
            info.take(2 if flags & 1 else 0)
            if info.unsigned(8) != UNDEFINED:
                raise CorruptFile(f"{of.name} has more attributes than its header holds")
        for fields in of.of(Message.ATTRIBUTE):
            name, attribute = _attribute(fields)
            if name in self._found or len(self._found) == _MOST:
                raise CorruptFile(f"{of.name} has attribute {name!r} twice, or too many")
            self._found[name] = attribute

    def __contains__(self, name: str) -> bool:
        return name in self._found

    def text(self, name: str, most_bytes: int) -> str:
        """Return an attribute that is UTF-8 text of variable length.

        Raises:
            CorruptFile: If there is none, or it is no such text of at most `most_bytes`.
        """
        found = self._value(name)
        if not isinstance(found, bytes):
            raise CorruptFile(f"its attribute {name} is a number, wanted a text")
        if len(found) > most_bytes:
            raise CorruptFile(f"its attribute {name} has {len(found)} bytes, at most {most_bytes}")
        try:
            return found.decode()
        except UnicodeDecodeError as error:
            raise CorruptFile(f"its attribute {name} is no text in UTF-8") from error

    def whole(self, name: str) -> int:
        """Return an attribute that is one whole number.

        Raises:
            CorruptFile: If there is none, or it is something else.
        """
        found = self._value(name)
        if not isinstance(found, int):
            raise CorruptFile(f"its attribute {name} is no whole number")
        return found

    def _value(self, name: str) -> bytes | int | None:
        if name not in self._found:
            raise CorruptFile(f"it has no attribute {name}")
        kind, shape, content = self._found[name]
        value = Fields(content, f"its attribute {name}")
        if shape_of(Fields(shape, value.name)):
            raise CorruptFile(f"{value.name} holds several values, wanted one")
        dtype = text_or_dtype(kind, value.name)
        if dtype is None:
            length, at, index = struct.unpack("<IQI", value.take(16))
            return self._text(at, index, length, name)
        if dtype.kind != "i":
            return None
        return int(np.frombuffer(value.take(dtype.itemsize), dtype)[0])

    def _text(self, at: int, index: int, length: int, name: str) -> bytes:
        if not length:
            return b""
        if at not in self._texts:
            self._texts[at] = self._collection(at)
        found = self._texts[at].get(index)
        if found is None or len(found) < length:
            raise CorruptFile(f"the text of its attribute {name} is not where it should be")
        return found[:length]

    def _collection(self, at: int) -> dict[int, bytes]:
        """Read a collection of texts: a global heap's, which has no checksum."""
        start = self._source.text(at, 16, "a collection of texts")
        start.expect(b"GCOL\x01\0\0\0", "its signature and version")
        size = start.unsigned(8)
        if size < 16:
            raise CorruptFile(f"a collection of texts has {size} bytes")
        objects = self._source.text(at + 16, size - 16, start.name)
        texts: dict[int, bytes] = {}
        while objects.left >= 16 and (index := objects.unsigned(2)):
            if index in texts or len(texts) == _MOST:
                raise CorruptFile(f"{start.name} holds text {index} twice, or too many")
            objects.take(6)
            length = objects.unsigned(8)
            texts[index] = objects.take(length)
            objects.take(min(-length % 8, objects.left))
        return texts


def _attribute(fields: Fields) -> tuple[str, tuple[bytes, bytes, bytes]]:
    """Return an attribute's name, and its kind, shape and value."""
    version, flags = fields.unsigned(1), fields.unsigned(1)
    if version not in {1, 2, 3} or (version > 1 and flags):
        raise CorruptFile(f"{fields.name} has an attribute that is not read here")
    sizes = [fields.unsigned(2) for _ in range(3)]
    fields.take(1 if version == 3 else 0)
    name, kind, shape = (
        fields.take(size + (-size % 8 if version == 1 else 0))[:size] for size in sizes
    )
    text = Fields(name, fields.name).text(len(name), "the name of an attribute")
    return text, (kind, shape, fields.take(fields.left))
