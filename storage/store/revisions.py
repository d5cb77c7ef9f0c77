"""Revisions: immutable files and the rows that name them."""

from collections.abc import Callable
from pathlib import Path

from storage.catalog import Catalog, RevisionFacts, RevisionRecord
from storage.errors import StorageError
from storage.files import make_folder, publish
from storage.names import new_id
from storage.store.layout import Layout

__all__ = ["Revisions"]


class Revisions:
    """The revisions of each map, newest first; `list`, `get` and `live` are the catalog's."""

    def __init__(self, catalog: Catalog, layout: Layout) -> None:
        self._catalog = catalog
        self._layout = layout
        self.list = catalog.revisions.list
        self.get = catalog.revisions.get
        self.live = catalog.revisions.live
        self.set_live = catalog.revisions.set_live

    def add(
        self,
        map_slug: str,
        digest: str,
        write: Callable[[Path], object],
        facts: RevisionFacts,
        *,
        make_live: bool = False,
    ) -> RevisionRecord:
        """Write a revision's file and add its row; the first one of a map becomes live.

        A digest that the map has already keeps its file and record.

        Args:
            map_slug: The map.
            digest: Of the revision's content, 64 hex digits.
            write: Writes the file at the path it is given.
            facts: What the builder knows about it.
            make_live: Make it live even if it is not the first.

        Raises:
            MapNotFound: If there is no such map.
            StorageFull: If no space is left; nothing is changed.
        """
        map_id = self._catalog.maps.get(map_slug).id
        # Its own name for every file: one that is being deleted and one that is being added with
        # the same digest cannot meet.
        name = f"{_checked_digest(digest)}.{new_id()[:8]}.h5"
        path = make_folder(self._layout.revisions(map_id)) / name
        try:
            with publish(path) as part:
                write(part)
                size_bytes = part.stat().st_size
            record = self._catalog.revisions.add(
                map_slug, digest, name, size_bytes, facts, make_live=make_live
            )
        except StorageError:  # nothing was committed; after any other error, who knows: see sweep
            path.unlink(missing_ok=True)
            raise
        if record.file_name != name:
            path.unlink()
        return record

    def path(self, map_slug: str, digest: str) -> Path:
        """Return the file of a revision, named by its digest or a unique prefix.

        Raises:
            MapNotFound: If there is no such map.
            RevisionNotFound: If it has no such revision.
            AmbiguousRevision: If several begin with this prefix.
        """
        return self._path(self._catalog.revisions.get(map_slug, digest))

    def delete(self, map_slug: str, digest: str) -> RevisionRecord:
        """Remove a revision that is not live: its row, then its file.

        Who has the file open can read it to the end.

        Raises:
            MapNotFound: If there is no such map.
            RevisionNotFound: If it has no such revision.
            RevisionIsLive: If it is the live one.
        """
        record = self._catalog.revisions.delete(map_slug, digest)
        self._path(record).unlink(missing_ok=True)
        return record

    def _path(self, record: RevisionRecord) -> Path:
        return self._layout.revisions(record.map_id) / record.file_name


def _checked_digest(digest: str) -> str:
    if len(digest) != 64 or set(digest) - set("0123456789abcdef"):
        raise ValueError(f"{digest[:80]!r} is no SHA-256 in lower-case hex")
    return digest
