"""Where the chunks of an array lie: one chunk, or a fixed array of their addresses."""

from dataclasses import dataclass

from storage.errors import CorruptFile
from storage.hdf5.source import UNDEFINED, Fields, Source

_CHECKSUM = 4


@dataclass(frozen=True)
class ChunkAddress:
    """Where one chunk lies.

    Attributes:
        at: Its address, `UNDEFINED` if it was never written.
        size: Its bytes, the checksum included.
        mask: Which filters were left out.
    """

    at: int
    size: int
    mask: int


def read_fixed_array(source: Source, at: int, wanted: int, name: str) -> list[ChunkAddress]:
    """Read the addresses of the first `wanted` chunks.

    Args:
        source: The file.
        at: Of the fixed array's header.
        wanted: How many; the caller knows that the file has as many bytes.
        name: The array, for errors.

    Raises:
        CorruptFile: If the index is damaged or shorter.
    """
    header = Fields(source.read(at, 28, f"the chunk index of {name}"), f"the chunk index of {name}")
    header.check_sum()
    header.expect(b"FAHD\0\x01", "its signature, version and client")
    entry, page_bits = header.unsigned(1), header.unsigned(1)
    count, block_at = header.unsigned(8), header.unsigned(8)
    if not 12 < entry <= 20 or not 0 < page_bits <= 20 or count < wanted:
        raise CorruptFile(f"{header.name} has {count} entries of {entry} bytes, wanted {wanted}")
    pages = _Pages(source, block_at, at, entry, 1 << page_bits, count, header.name)
    return pages.first(wanted)


class _Pages:
    """The data block of a fixed array: in one piece if it is short, else in pages."""

    def __init__(
        self, source: Source, at: int, owner: int, entry: int, page: int, count: int, name: str
    ) -> None:
        self._source, self._at, self._owner = source, at, owner
        self._entry, self._page, self._count, self._name = entry, page, count, name

    def first(self, wanted: int) -> list[ChunkAddress]:
        if self._count <= self._page:
            block = self._checked(self._at, 14 + self._count * self._entry)
            self._begin(block)
            return self._entries(block, wanted)
        pages = -(-self._count // self._page)
        start = self._checked(self._at, 14 + (pages + 7) // 8)
        self._begin(start)
        written = start.take((pages + 7) // 8)
        at = self._at + len(start.content) + _CHECKSUM
        found: list[ChunkAddress] = []
        for number in range(-(-wanted // self._page)):
            here = min(self._page, wanted - len(found))
            size = min(self._page, self._count - number * self._page) * self._entry
            if written[number // 8] >> (7 - number % 8) & 1:
                found += self._entries(self._checked(at, size), here)
            else:
                found += [ChunkAddress(UNDEFINED, 0, 0)] * here
            at += size + _CHECKSUM
        return found

    def _checked(self, at: int, size: int) -> Fields:
        """Read a piece, check the sum that follows it, and return it without."""
        whole = Fields(self._source.read(at, size + _CHECKSUM, self._name), self._name)
        whole.check_sum()
        return Fields(whole.content[:-_CHECKSUM], self._name)

    def _begin(self, block: Fields) -> None:
        block.expect(b"FADB\0\x01", "its data's signature, version and client")
        if block.unsigned(8) != self._owner:
            raise CorruptFile(f"{self._name}: its data belong elsewhere")

    def _entries(self, fields: Fields, wanted: int) -> list[ChunkAddress]:
        return [
            ChunkAddress(fields.unsigned(8), fields.unsigned(self._entry - 12), fields.unsigned(4))
            for _ in range(wanted)
        ]
