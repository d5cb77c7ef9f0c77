"""Maps and all their files."""

import shutil
from collections.abc import Collection

from storage.catalog import Catalog, MapRecord
from storage.store.layout import Layout


class Maps:
    """The maps, in the order of their slugs."""

    def __init__(self, catalog: Catalog, layout: Layout) -> None:
        self._catalog = catalog
        self._layout = layout
        self.create = catalog.maps.create
        self.get = catalog.maps.get
        self.get_by_id = catalog.maps.get_by_id
        self.list = catalog.maps.list
        self.update = catalog.maps.update
        self.delete = catalog.recycle_bin.put_map

    def purge(self, slug: str, *, if_versions: Collection[int] | None = None) -> MapRecord:
        """Remove a map with its drives, revisions and jobs: the rows at once, then the files.

        What a crash leaves of the files, the next start moves to `orphans/`.

        Raises:
            MapNotFound: If there is none of that slug.
            MapChanged: If its version is none of `if_versions`.
        """
        record = self._catalog.maps.delete(slug, if_versions=if_versions)
        shutil.rmtree(self._layout.map(record.id), ignore_errors=True)
        return record
