"""Addresses of an array's chunks: one chunk, or a fixed array of addresses."""

from dataclasses import dataclass

from storage.errors import CorruptFile
from storage.hdf5.source import UNDEFINED, Fields, Source

_CHECKSUM = 4


@dataclass(frozen=True)
class ChunkAddress:
    """Location of one chunk.

    Attributes:
        at: The chunk's address, `UNDEFINED` if it was never written.
        size: The chunk's size in bytes, the checksum included.
        mask: The filters that were not applied.
    """

    at: int
    size: int
    mask: int


def read_fixed_array(source: Source, at: int, count: int, name: str) -> list[ChunkAddress]:
    """Read the addresses of the first `count` chunks.

    Args:
        source: The file.
        at: Address of the fixed array's header.
        count: Number of chunks; the caller has checked that the file is that long.
        name: The array, for errors.

    Raises:
        CorruptFile: If the index is damaged or shorter.
    """
    name = f"the chunk index of {name}"
    header = Fields(source.read(at, 28, name), name)
    header.check_sum()
    header.expect(b"FAHD\0\x01", "its signature, version and client")
    entry_bytes, page_bits = header.unsigned(1), header.unsigned(1)
    entries, block_at = header.unsigned(8), header.unsigned(8)
    if not 12 < entry_bytes <= 20 or not 0 < page_bits <= 20 or entries < count:
        raise CorruptFile(f"{name} has {entries} entries of {entry_bytes} bytes, wanted {count}")
    page = 1 << page_bits
    pages = -(-entries // page)
    # A short data block is in one piece, a longer one has a bitmap of its pages, then the pages.
    in_pages = entries > page
    block_bytes = 14 + ((pages + 7) // 8 if in_pages else entries * entry_bytes)
    block = _checked(source, block_at, block_bytes, name)
    block.expect(b"FADB\0\x01", "its data's signature, version and client")
    if block.unsigned(8) != at:
        raise CorruptFile(f"{name}: its data belong elsewhere")
    if not in_pages:
        return _addresses(block, entry_bytes, count)
    written = block.take(block.left)
    page_at = block_at + block_bytes + _CHECKSUM
    found: list[ChunkAddress] = []
    for number in range(-(-count // page)):
        of_page = min(page, count - len(found))
        page_bytes = min(page, entries - number * page) * entry_bytes
        if written[number // 8] >> (7 - number % 8) & 1:
            found += _addresses(_checked(source, page_at, page_bytes, name), entry_bytes, of_page)
        else:
            found += [ChunkAddress(UNDEFINED, 0, 0)] * of_page
        page_at += page_bytes + _CHECKSUM
    return found


def _checked(source: Source, at: int, size: int, name: str) -> Fields:
    """Read a piece, check the checksum that follows it, and return it without."""
    whole = Fields(source.read(at, size + _CHECKSUM, name), name)
    whole.check_sum()
    return Fields(whole.content[:-_CHECKSUM], name)


def _addresses(fields: Fields, entry_bytes: int, count: int) -> list[ChunkAddress]:
    return [
        ChunkAddress(fields.unsigned(8), fields.unsigned(entry_bytes - 12), fields.unsigned(4))
        for _ in range(count)
    ]
