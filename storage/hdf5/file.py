"""A file of arrays in its root, read without the HDF5 library."""

from functools import cached_property

from storage.closing import Closing
from storage.errors import CorruptFile
from storage.hdf5.attributes import Attributes
from storage.hdf5.dataset import Dataset, open_dataset
from storage.hdf5.links import read_links
from storage.hdf5.object_header import read_messages
from storage.hdf5.source import UNDEFINED, Source

_SIGNATURE = b"\x89HDF\r\n\x1a\n"


class Hdf5File(Closing):
    """The arrays and attributes of the root group of an HDF5 file.

    It reads what `docs/reference/format.md` lists and rejects all else by name. Every address is
    checked to be within the file, no structure is followed without end, and time and memory are
    bounded by the file's size, whatever its bytes are.

    Args:
        source: The bytes.

    Raises:
        CorruptFile: If it is no such file.

    Attributes:
        attributes: The root's attributes.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        root = read_messages(source, _root_address(source), "the root")
        self._links = read_links(source, root)
        self.attributes = Attributes(source, root)

    @cached_property
    def names(self) -> frozenset[str]:
        """The names of the root's members."""
        return frozenset(self._links)

    def dataset(self, name: str, *, contiguous: bool = False) -> Dataset:
        """Return the array of a name; its numbers are read on demand.

        Raises:
            CorruptFile: If there is none, or one that is not supported; the message says why.
        """
        if name not in self._links:
            raise CorruptFile(f"it has no array {name}")
        if (address := self._links[name]) is None:
            raise CorruptFile(f"{name} is no plain array of numbers: it is a link elsewhere")
        messages = read_messages(self._source, address, name)
        return open_dataset(self._source, messages, contiguous=contiguous)

    def close(self) -> None:
        """Close the file."""
        self._source.close()


def _root_address(source: Source) -> int:
    if source.size_bytes < 9 or source.read(0, 8, "its signature") != _SIGNATURE:
        raise CorruptFile("it is no HDF5 file: it lacks the signature at its beginning")
    version = source.read(8, 1, "its version")[0]
    if version == 0:
        block = source.structure(0, 96, "the superblock")
        block.take(9)
        block.expect(bytes(4), "the versions of its parts")
        block.expect(b"\x08\x08\0", "the size of addresses and lengths")
        block.take(8)
        base, _, end, driver = (block.unsigned(8) for _ in range(4))
        block.take(8)
        address = block.unsigned(8)
    elif version in {2, 3}:
        block = source.checked(0, 48, "the superblock")
        block.take(9)
        block.expect(b"\x08\x08\0", "the size of addresses and lengths, and whether it is open")
        base, driver, end, address = (block.unsigned(8) for _ in range(4))
    else:
        raise CorruptFile(f"its superblock is of version {version}, wanted 0, 2 or 3")
    if base != 0 or driver != UNDEFINED:
        raise CorruptFile(f"{block.name} begins elsewhere or has an extension or driver")
    if end > source.size_bytes:
        raise CorruptFile(f"it is cut off: {end} bytes were written, {source.size_bytes} are left")
    return address
