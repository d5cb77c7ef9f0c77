"""The fractal heap, in which a group of many members stores its links."""

from storage.errors import CorruptFile
from storage.hdf5.source import UNDEFINED, Fields, Source

_MOST_BYTES = 2**16  # of one direct block


class FractalHeap:
    """A heap of small objects in blocks, of one level at most; checksums are checked.

    Raises:
        CorruptFile: If it is damaged, filtered, or larger than any of ours.
    """

    def __init__(self, source: Source, at: int, owner: str) -> None:
        self._source = source
        self._name = f"the heap of {owner}"
        header = source.checked(at, 146, self._name)
        header.expect(b"FRHP\0", "its signature and version")
        self._id_bytes = header.unsigned(2)
        filtered, self._flags, most = header.unsigned(2), header.unsigned(1), header.unsigned(4)
        if filtered:
            raise CorruptFile(f"{self._name} is filtered")
        header.take(12 * 8)
        width, first, largest = header.unsigned(2), header.unsigned(8), header.unsigned(8)
        bits = header.unsigned(2)
        header.take(2)
        root, rows = header.unsigned(8), header.unsigned(2)
        if not (0 < first <= largest <= _MOST_BYTES and 0 < width <= 16 and bits <= 64):
            raise CorruptFile(f"{self._name} has blocks of {first} to {largest} bytes")
        self._at = at
        self._offset_bytes = (bits + 7) // 8
        self._length_bytes = min(_bytes_for(largest - 1), _bytes_for(most))
        self._blocks: dict[tuple[int, int], int] = {}  # (offset in the heap, size): address
        self._read: dict[int, bytes] = {}
        if root != UNDEFINED and rows == 0:
            self._blocks[0, first] = root
        elif root != UNDEFINED:
            self._list(root, rows, width, first, largest)

    def object(self, identity: bytes) -> bytes:
        """Return the object of an id.

        Raises:
            CorruptFile: If the heap does not hold it.
        """
        fields = Fields(identity, f"an object in {self._name}")
        if len(identity) != self._id_bytes or fields.unsigned(1):
            raise CorruptFile(f"{fields.name} is of a kind that is not read here")
        offset = fields.unsigned(self._offset_bytes)
        length = fields.unsigned(self._length_bytes)
        for (begin, size), address in self._blocks.items():
            if begin <= offset and offset + length <= begin + size and address != UNDEFINED:
                return self._block(begin, size, address)[offset - begin : offset - begin + length]
        raise CorruptFile(f"{fields.name} is in none of its blocks")

    def _list(self, at: int, rows: int, width: int, first: int, largest: int) -> None:
        if rows > 16:
            raise CorruptFile(f"{self._name} has {rows} rows of blocks")
        head_bytes = 4 + 1 + 8 + self._offset_bytes
        block = self._source.checked(at, head_bytes + rows * width * 8 + 4, self._name)
        self._begin(block, b"FHIB", 0)
        offset = 0
        for row in range(rows):
            size = first << max(0, row - 1)
            if size > largest:
                raise CorruptFile(f"{self._name} has more than one level")
            for _ in range(width):
                self._blocks[offset, size] = block.unsigned(8)
                offset += size

    def _block(self, offset: int, size: int, address: int) -> bytes:
        if (found := self._read.get(address)) is not None:
            return found
        block = self._source.structure(address, size, self._name)
        self._begin(block, b"FHDB", offset)
        if self._flags & 2:  # a checksum, which counts as zeros in itself
            checksum = block.take(4)
            end = block.at
            blank = block.content[: end - 4] + bytes(4) + block.content[end:]
            Fields(blank + checksum, self._name).check_sum()
        self._read[address] = block.content
        return block.content

    def _begin(self, block: Fields, signature: bytes, offset: int) -> None:
        block.expect(signature + b"\0", "a block's signature and version")
        if block.unsigned(8) != self._at or block.unsigned(self._offset_bytes) != offset:
            raise CorruptFile(f"{self._name}: a block belongs elsewhere")


def _bytes_for(most: int) -> int:
    return max(1, (most.bit_length() + 7) // 8)
