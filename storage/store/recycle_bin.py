"""The recycle bin and the files of what is in it."""

import shutil
from datetime import datetime

from storage.catalog import Catalog, RecycledRecord
from storage.store.layout import Layout


class RecycleBin:
    """Deleted maps and drives, the last one first; all but `purge` is the catalog's."""

    def __init__(self, catalog: Catalog, layout: Layout) -> None:
        self._catalog = catalog
        self._layout = layout
        self.get = catalog.recycle_bin.get
        self.list = catalog.recycle_bin.list
        self.expired = catalog.recycle_bin.expired
        self.restore = catalog.recycle_bin.restore

    def purge(self, entry_id: str, *, before: datetime | None = None) -> RecycledRecord:
        """Remove a deleted map or drive for good: its rows at once, then its files.

        What a crash leaves of the files, the next start moves to `orphans/`.

        Raises:
            NotInRecycleBin: If it is not there, or no longer, or was deleted after `before`.
        """
        entry = self._catalog.recycle_bin.purge(entry_id, before=before)
        if entry.drive_slug is None:
            folder = self._layout.map(entry.map_id)
        else:
            folder = self._layout.drive(entry.map_id, entry.id)
        shutil.rmtree(folder, ignore_errors=True)
        return entry
