"""The members of a group, in each of the ways in which HDF5 lists them."""

from storage.errors import CorruptFile
from storage.hdf5.fractal_heap import FractalHeap
from storage.hdf5.object_header import Message, Messages
from storage.hdf5.source import UNDEFINED, Fields, Source

_MOST_LINKS = 64
"""More than any file of ours has in its root."""

_NAME = "the name of a member"
_HARD = 0  # a link to an object of the file; others refer to another name or file

_Link = tuple[str, int | None]


def read_links(source: Source, group: Messages) -> dict[str, int | None]:
    """Return the header's address of each member of a group, by name.

    The address is `None` where the member is a link to another name or file.

    Raises:
        CorruptFile: If the list is damaged, or a name is in it twice.
    """
    table = group.optional(Message.SYMBOL_TABLE)
    links = [_link(fields) for fields in group.of(Message.LINK)]
    info = group.optional(Message.LINK_INFO)
    if table is None and info is None:
        raise CorruptFile(f"{group.name} is no group")
    if table is not None:
        links += _of_table(source, table)
    if info is not None:
        links += _of_heap(source, info)
    if len(links) > _MOST_LINKS:
        raise CorruptFile(f"{group.name} has more than {_MOST_LINKS} members")
    named = dict(links)
    if len(named) != len(links):
        raise CorruptFile(f"{group.name} has two members of one name")
    return named


def _link(fields: Fields) -> _Link:
    fields.expect(b"\x01", "a link's version")
    flags = fields.unsigned(1)
    kind = fields.unsigned(1) if flags & 8 else 0
    fields.take((8 if flags & 4 else 0) + (1 if flags & 16 else 0))
    name = fields.text(fields.unsigned(1 << (flags & 3)), _NAME)
    return name, fields.unsigned(8) if kind == _HARD else None


def _of_heap(source: Source, info: Fields) -> list[_Link]:
    info.expect(b"\0", "the version of its links")
    if info.unsigned(1) & 1:
        info.take(8)
    heap_at, tree_at = info.unsigned(8), info.unsigned(8)
    if heap_at == UNDEFINED:
        return []
    heap = FractalHeap(source, heap_at, info.name)
    return [
        _link(Fields(heap.object(record[4:]), info.name))
        for record in _records(source, tree_at, info.name)
    ]


def _records(source: Source, at: int, group: str) -> list[bytes]:
    """Return the records of a B-tree of version 2 that is one leaf: a hash and a heap's id."""
    name = f"the index of {group}"
    header = source.checked(at, 38, name)
    header.expect(b"BTHD\0\x05", "its signature, version and type")
    node_size, size, depth = header.unsigned(4), header.unsigned(2), header.unsigned(2)
    header.take(2)
    root, count = header.unsigned(8), header.unsigned(2)
    if not count and root == UNDEFINED:
        return []
    if depth or count > _MOST_LINKS or size < 5 or 10 + count * size > node_size:
        raise CorruptFile(f"{name} has {count} records at depth {depth}: too many members")
    leaf = source.checked(root, 10 + count * size, name)
    leaf.expect(b"BTLF\0\x05", "its signature, version and type")
    return [leaf.take(size) for _ in range(count)]


def _of_table(source: Source, table: Fields) -> list[_Link]:
    tree_at, heap_at = table.unsigned(8), table.unsigned(8)
    heap = source.structure(heap_at, 32, f"the names of {table.name}")
    heap.expect(b"HEAP\0\0\0\0", "their signature and version")
    size, _, names_at = heap.unsigned(8), heap.unsigned(8), heap.unsigned(8)
    names = source.structure(names_at, size, heap.name).content
    tree = source.structure(tree_at, 24, f"the index of {table.name}")
    tree.expect(b"TREE\0\0", "its signature, type and level")
    nodes = tree.unsigned(2)
    if nodes > _MOST_LINKS:
        raise CorruptFile(f"{table.name} has more than {_MOST_LINKS} members")
    children = source.structure(tree_at + 24, nodes * 16, tree.name)
    links: list[_Link] = []
    for _ in range(nodes):
        children.take(8)
        links += _of_node(source, children.unsigned(8), names, table.name)
    return links


def _of_node(source: Source, at: int, names: bytes, group: str) -> list[_Link]:
    node = source.structure(at, 8, f"a list of members of {group}")
    node.expect(b"SNOD\x01\0", "its signature and version")
    count = node.unsigned(2)
    if count > _MOST_LINKS:
        raise CorruptFile(f"{group} has more than {_MOST_LINKS} members")
    entries = source.structure(at + 8, count * 40, node.name)
    links: list[_Link] = []
    for _ in range(count):
        begin, address, kind = entries.unsigned(8), entries.unsigned(8), entries.unsigned(4)
        entries.take(20)
        end = names.find(b"\0", begin)
        if begin >= len(names) or end < 0:
            raise CorruptFile(f"{group}: the name of a member is cut off")
        name = Fields(names[begin:end], group).text(end - begin, _NAME)
        links.append((name, None if kind == 2 else address))
    return links
