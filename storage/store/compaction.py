"""Compaction: a closed drive's many small chunk files become a few big ones."""

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from core.scans.scan import Scan
from core.text import count_of
from storage.catalog import Catalog, ScanRecord
from storage.errors import CorruptFile
from storage.files.drive_chunks import BYTES_PER_RETURN, write_chunk
from storage.files.files import discard, discarded_on_rollback
from storage.files.free_space import OF_SCANS
from storage.names import new_id

_CHUNK_BYTES = 64 * 2**20  # in memory while it is written; some 90 scans of 60,000 returns

_log = logging.getLogger("tensormap.storage")


def compact(catalog: Catalog, drive_id: str, chunks: Path, read: Callable[[int], Scan]) -> None:
    """Rewrite the chunk files of a closed drive, `chunks`, into ones of some 64 MB.

    A new file is on disk before one transaction moves the rows to it, and the old ones are removed
    after that: a crash leaves each scan readable and at most one orphan. A second call changes
    nothing. Damaged scans stay in their files.

    Raises:
        LostRace: If another writer compacts or removes the drive.
        StorageFull: If no space is left; the groups that were moved stay moved.
    """
    records = [record for record in catalog.scans.of_drive(drive_id) if record.has_returns]
    sizes = Counter(record.chunk for record in records)
    for group in in_chunks(records):
        if not _is_one_file(group, sizes):
            good, scans = _good_scans(group, read)
            if not _is_one_file(good, sizes):
                size_bytes = sum(record.returns for record in good) * BYTES_PER_RETURN
                OF_SCANS.require(chunks, size_bytes, "a file of several scans")
                move_into_one(catalog, drive_id, chunks, good, scans.__getitem__)


def _is_one_file(group: Sequence[ScanRecord], sizes: Mapping[str, int]) -> bool:
    """Return whether scans are all that one file holds; also of no scan."""
    in_group = Counter(record.chunk for record in group)
    return len(in_group) < 2 and all(count == sizes[name] for name, count in in_group.items())


def _good_scans(
    group: Sequence[ScanRecord], read: Callable[[int], Scan]
) -> tuple[list[ScanRecord], dict[int, Scan]]:
    """Read those of some scans that are not damaged or gone; log that others are.

    Returns:
        What the catalog has of each good scan, and the scans by their indices.
    """
    scans: dict[int, Scan] = {}
    faults = []
    for record in group:
        try:
            scans[record.index] = read(record.index)
        except CorruptFile as error:
            faults.append(error)
    if faults:
        _log.warning("%s not packed: %s", count_of(len(faults), "scan"), faults[0])
    return [record for record in group if record.index in scans], scans


def move_into_one(
    catalog: Catalog,
    drive_id: str,
    chunks: Path,
    group: Sequence[ScanRecord],
    read: Callable[[int], Scan],
) -> None:
    """Move scans into a new chunk file of their own, and remove files that no longer hold a scan.

    Raises:
        LostRace: If another writer moves one of them or removes the drive.
        StorageFull: If no space is left; nothing is changed.
    """
    name = f"{new_id()}.h5"
    scans = [(record.index, read(record.index)) for record in group]
    with discarded_on_rollback(chunks / name):
        write_chunk(chunks / name, scans)
        emptied = catalog.scans.move(drive_id, group, name)
    for old in emptied:
        discard(chunks / old)


def in_chunks(records: Sequence[ScanRecord]) -> Iterator[list[ScanRecord]]:
    """Split scans, in their order, into groups that fill a chunk."""
    group: list[ScanRecord] = []
    filled = 0
    for record in records:
        size = record.returns * BYTES_PER_RETURN
        if group and filled + size > _CHUNK_BYTES:
            yield group
            group, filled = [], 0
        group.append(record)
        filled += size
    if group:
        yield group
