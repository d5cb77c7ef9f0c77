"""The recycle bin and the files of what is in it."""

from storage.catalog import Catalog, RecycledRecord
from storage.store.purges import Purges


class RecycleBin:
    """Deleted maps and drives, the last one first; all but `purge` is the catalog's."""

    def __init__(self, catalog: Catalog, purges: Purges) -> None:
        self._catalog = catalog
        self._purges = purges
        self.get = catalog.recycle_bin.get
        self.list = catalog.recycle_bin.list
        self.expired = catalog.recycle_bin.expired
        self.restore = catalog.recycle_bin.restore
        self.begin_purge = catalog.recycle_bin.begin_purge

    def purge(self, entry_id: str) -> RecycledRecord:
        """Remove a deleted map or drive for good: nobody finds it at once, then rows and files go.

        Raises:
            NotInRecycleBin: If it is not there, or no longer.
        """
        entry = self._catalog.recycle_bin.begin_purge(entry_id)
        self._purges.finish(entry)
        return entry
