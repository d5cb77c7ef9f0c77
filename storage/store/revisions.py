"""Revisions: immutable files and the rows that name them."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from core.mapping.placement import Placement
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from storage.catalog import Catalog, RevisionFacts, RevisionRecord
from storage.errors import CorruptFile
from storage.files.claims import remove_half_written, writing_in
from storage.files.files import (
    discard,
    discarded_on_rollback,
    make_folder,
    named_disk_errors,
    publish,
    sync,
)
from storage.files.free_space import OF_SCANS
from storage.files.map_file import read_parameters, read_revision
from storage.names import new_id
from storage.retention import Retention
from storage.store.layout import Layout


class Revisions:
    """The revisions of each map, newest first; methods that only read rows are the catalog's."""

    def __init__(self, catalog: Catalog, layout: Layout) -> None:
        self._catalog = catalog
        self._layout = layout
        self.list = catalog.revisions.list
        self.get = catalog.revisions.get
        self.live = catalog.revisions.live
        self.of_map = catalog.revisions.of_map
        self.with_basis = catalog.revisions.with_basis
        self.set_live = catalog.revisions.set_live
        self.collectable = catalog.collector.collectable

    def add(
        self,
        map_id: str,
        digest: str,
        write: Callable[[Path], object],
        facts: RevisionFacts,
        *,
        make_live: bool = False,
        if_live: str | None = None,
    ) -> RevisionRecord:
        """Write a revision's file and add its row; the first one of a map becomes live.

        A digest that the map has already keeps its record, and the file replaces its first one.

        Args:
            map_id: The map; a new one under the same slug has another id.
            digest: Digest of the revision's content, 64 hex digits.
            write: Writes the file to a path.
            facts: What the builder knows about it.
            make_live: Make it live even if it is not the first.
            if_live: The revision that must be live now, empty for none; any by default.

        Raises:
            MapNotFound: If the map is gone.
            LostRace: If another revision than `if_live` is live; nothing is changed.
            StorageFull: If no space is left; nothing is changed.
        """
        self._catalog.maps.get_by_id(map_id)
        # Every file has its own name: one that is being deleted and one that is being added with
        # the same digest cannot conflict.
        name = f"{_checked_digest(digest)}.{new_id()[:8]}.h5"
        path = self._layout.revisions(map_id) / name
        try:
            make_folder(path.parent)
            with discarded_on_rollback(path):
                with named_disk_errors(), writing_in(path.parent), publish(path) as part:
                    write(part)
                    OF_SCANS.require_kept(part.parent, "the revision")
                    size_bytes = part.stat().st_size
                record = self._catalog.revisions.add(
                    map_id, digest, name, size_bytes, facts, make_live=make_live, if_live=if_live
                )
        except FileNotFoundError:  # the map's folder was removed, and its row before that
            self._catalog.maps.get_by_id(map_id)
            self._catalog.require_writable()  # it may be the whole folder that is gone
            raise
        if record.file_name != name:
            # The first one may be lost or damaged, and this one has just been read back.
            with named_disk_errors():
                path.replace(self.path_of(record))
                sync(path.parent)
        return record

    def open(self, map_slug: str, digest: str) -> tuple[RevisionRecord, BinaryIO]:
        """Open the file of a revision; it can be read to its end even if it is deleted meanwhile.

        Raises:
            MapNotFound: If there is no such map.
            RevisionNotFound: If it has no such revision, or no longer.
            AmbiguousRevision: If several begin with this prefix.
            CorruptFile: If its file is gone, cannot be read, or is not what was stored.
        """
        record = self._catalog.revisions.get(map_slug, digest)
        path = self.path_of(record)
        with self._stored(record):
            file = path.open("rb")
            try:
                read_revision(path, record.digest)
            except BaseException:
                file.close()
                raise
            return record, file

    def read(self, record: RevisionRecord) -> TensorMap:
        """Read a revision, whole or not at all.

        Raises:
            MapNotFound: If the map was deleted meanwhile.
            RevisionNotFound: If the revision was.
            CorruptFile: If its file is gone, or is not what was stored.
        """
        with self._stored(record):
            return read_revision(self.path_of(record), record.digest)

    def read_parameters(
        self, record: RevisionRecord
    ) -> tuple[MapParameters, Mapping[str, Placement | None]]:
        """Return a revision's parameters, and its drives with the transforms of their poses.

        No array is read.

        Raises:
            MapNotFound: If the map was deleted meanwhile.
            RevisionNotFound: If the revision was.
            CorruptFile: If its file is gone, or has the digest of another revision.
        """
        with self._stored(record):
            return read_parameters(self.path_of(record), record.digest)

    def delete(self, map_slug: str, digest: str) -> RevisionRecord:
        """Remove a revision that is not live: its row, then its file.

        A process that has the file open can read it to the end.

        Raises:
            MapNotFound: If there is no such map.
            RevisionNotFound: If it has no such revision.
            RevisionIsLive: If it is the live one.
        """
        record = self._catalog.revisions.delete(map_slug, digest)
        discard(self.path_of(record))
        return record

    def collect(self, map_id: str, digest: str, default: Retention) -> RevisionRecord:
        """Remove a revision that its map's policy does not keep: its row, then its file.

        A process that has it open, or in memory, can read it to the end.

        Raises:
            MapNotFound: If the map is gone.
            LostRace: If it is to be kept: it was made live meanwhile, or a job is based on it.
        """
        record = self._catalog.collector.collect(map_id, digest, default)
        discard(self.path_of(record))
        return record

    def remove_half_written(self, map_id: str) -> None:
        """Remove what killed builds have written of revisions of a map."""
        remove_half_written(self._layout.revisions(map_id))

    def path_of(self, record: RevisionRecord) -> Path:
        """Return the file of a revision."""
        return self._layout.revisions(record.map_id) / record.file_name

    @contextmanager
    def _stored(self, record: RevisionRecord) -> Iterator[None]:
        try:
            yield
        except FileNotFoundError as error:
            self._catalog.revisions.of_map(record.map_id, record.digest)  # or it was deleted
            self._catalog.require_writable()  # it may be the whole folder that is gone
            raise CorruptFile(f"the file of revision {record.digest} is gone") from error
        except OSError as error:
            raise CorruptFile(
                f"the file of revision {record.digest} cannot be read: {error.strerror}"
            ) from error


def _checked_digest(digest: str) -> str:
    if len(digest) != 64 or set(digest) - set("0123456789abcdef"):
        raise ValueError(f"{digest[:80]!r} is no SHA-256 in lower-case hex")
    return digest
