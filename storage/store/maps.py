"""Maps and all their files."""

from collections.abc import Collection

from storage.catalog import Catalog, RecycledRecord
from storage.store.purges import Purges


class Maps:
    """The maps, in the order of their slugs."""

    def __init__(self, catalog: Catalog, purges: Purges) -> None:
        self._catalog = catalog
        self._purges = purges
        self.create = catalog.maps.create
        self.get = catalog.maps.get
        self.get_by_id = catalog.maps.get_by_id
        self.list = catalog.maps.list
        self.update = catalog.maps.update
        self.delete = catalog.recycle_bin.put_map

    def purge(self, slug: str, *, if_versions: Collection[int] | None = None) -> RecycledRecord:
        """Remove a map for good: nobody finds it at once, then its rows and files go.

        Raises:
            MapNotFound: If there is none of that slug.
            MapChanged: If its version is none of `if_versions`.
        """
        entry = self._catalog.recycle_bin.put_map(slug, if_versions=if_versions, purging=True)
        self._purges.finish(entry)
        return entry
