"""Dropping the returns of scans that a map was built of: what else is known of them stays."""

from collections.abc import Callable, Collection
from pathlib import Path

from core.scans.scan import Scan
from storage.catalog import Catalog, DriveRecord, on_behalf
from storage.files.files import discard
from storage.retention import Retention
from storage.store.compaction import in_chunks, move_into_one


def drop_returns(
    catalog: Catalog,
    drive: DriveRecord,
    live_revision: str,
    indices: Collection[int],
    default: Retention,
    chunks: Path,
    read: Callable[[int], Scan],
) -> None:
    """Drop the returns of some scans of a closed drive.

    What stays in a chunk file with them moves into another one first; then the rows let go of the
    file, and then it is removed. A crash in between leaves a file too many, which the next start
    sets aside, and never a row without its file.

    Raises:
        MapNotFound: If the map is gone.
        LostRace: If the map changed meanwhile, or its policy keeps them: nothing is dropped.
        StorageFull: If no space is left for what stays; nothing is dropped.
    """
    records = [record for record in catalog.scans.of_drive(drive.id) if record.has_returns]
    dropped = {record.chunk for record in records if record.index in indices}
    staying = [
        record for record in records if record.chunk in dropped and record.index not in indices
    ]
    with on_behalf(None):  # nothing is dropped by this
        for group in in_chunks(staying):
            move_into_one(catalog, drive.id, chunks, group, read)
    emptied = catalog.collector.drop_returns(
        drive.map_id, live_revision, drive.id, indices, default
    )
    for chunk in emptied:
        discard(chunks / chunk)
