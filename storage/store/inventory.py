"""The files that the catalog names, and the images that builds keep of its drives."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from storage.catalog import Catalog, ScanRecord
from storage.errors import ScanNotFound
from storage.files.checker import Checker
from storage.files.files import entries
from storage.files.image_file import is_image_file_name
from storage.files.stored_file import Fault, StoredFile
from storage.store.layout import ANY_IMAGES, Layout


class Inventory:
    """The files that should be in a data directory according to the catalog.

    Args:
        catalog: Names the files.
        layout: Locates them.
    """

    def __init__(self, catalog: Catalog, layout: Layout) -> None:
        self._catalog = catalog
        self._layout = layout

    def files(self) -> Iterator[StoredFile]:
        """Yield each file, map by map; files that are added meanwhile may be left out."""
        revisions = self._catalog.revisions.files_by_map()
        lacks_returns = self._catalog.scans.lacking_returns().__contains__
        for map_id, drives in self._drives():
            for drive_id in drives:
                yield from self._of_drive(map_id, drive_id)
                yield from map(StoredFile, self._images(map_id, drive_id, lacks_returns))
            folder = self._path(self._layout.revisions(map_id))
            for name, digest in sorted(revisions.get(map_id, {}).items()):
                yield StoredFile(f"{folder}/{name}", revision=digest)
        folder = self._path(self._layout.bases)
        for name, digest in sorted(self._catalog.bases.files().items()):
            yield StoredFile(f"{folder}/{name}", basis=digest)

    def paths(self) -> list[str]:
        """Return the paths of all files, in the order of `files`, without reading rows of scans."""
        found = []
        revisions = self._catalog.revisions.files_by_map()
        chunks = self._catalog.scans.chunks_by_drive()
        lacks_returns = self._catalog.scans.lacking_returns().__contains__
        for map_id, drives in self._drives():
            for drive_id in drives:
                folder = self._path(self._layout.chunks(map_id, drive_id))
                found += [f"{folder}/{name}" for name in sorted(chunks.get(drive_id, ()))]
                found += self._images(map_id, drive_id, lacks_returns)
            folder = self._path(self._layout.revisions(map_id))
            found += [f"{folder}/{name}" for name in sorted(revisions.get(map_id, ()))]
        folder = self._path(self._layout.bases)
        return [*found, *(f"{folder}/{name}" for name in sorted(self._catalog.bases.files()))]

    def file(self, path: str) -> StoredFile | None:
        """Return the file of a path, `None` if nothing names it, or no longer."""
        named = StoredFile(path)
        if named.kind == "bases":
            digest = self._catalog.bases.files().get(named.name)
            return None if digest is None else StoredFile(path, basis=digest)
        if named.kind == "revisions":
            digest = self._catalog.revisions.files(named.map_id).get(named.name)
            return None if digest is None else StoredFile(path, revision=digest)
        if named.kind == "chunks":
            records = self._catalog.scans.of_chunk(named.drive_id, named.name)
            return _of_scans(path, records) if records else None
        lacks_returns = self._catalog.scans.lacks_returns
        images = self._images(named.map_id, named.drive_id, lacks_returns)
        return named if path in images else None

    def fault(self, file: StoredFile, checker: Checker) -> Fault | None:
        """Return the fault of a file; one that is gone, and no longer named, has none.

        Raises:
            FileNotFoundError: If it is gone, and still named.
        """
        try:
            return checker.fault(self._layout.data_dir / file.path, file)
        except FileNotFoundError:
            if not self._is_named(file):  # deleted or moved meanwhile
                return None
            self._catalog.require_writable()  # it may be the whole folder that is gone
            raise

    def described(self, file: StoredFile, fault: Fault | None = None) -> str:
        """Return a description of a file for users, without the scans that are still good."""
        good_rows = () if fault is None else fault.good_rows
        return file.described(self._catalog.drives.slugs_by_id(), good_rows)

    def _drives(self) -> Iterator[tuple[str, list[str]]]:
        for map_id, drives in sorted(self._catalog.drives.by_map().items()):
            yield map_id, sorted(drives)

    def _of_drive(self, map_id: str, drive_id: str) -> Iterator[StoredFile]:
        chunks: dict[str, list[ScanRecord]] = {}
        for record in self._catalog.scans.of_drive(drive_id):
            if record.has_returns:
                chunks.setdefault(record.chunk, []).append(record)
        folder = self._path(self._layout.chunks(map_id, drive_id))
        for name, records in sorted(chunks.items()):
            yield _of_scans(f"{folder}/{name}", records)

    def _is_named(self, file: StoredFile) -> bool:
        """Return whether a row still names a file; if it is where it was, one of its scans says so.

        All scans of a file are found by reading all rows of the drive.
        """
        if file.indices:
            with suppress(ScanNotFound):
                one = self._catalog.scans.get(file.drive_id, min(file.indices.values()))
                if one.chunk == file.name:
                    return True
        return self.file(file.path) is not None

    def _images(
        self, map_id: str, drive_id: str, lacks_returns: Callable[[str], bool]
    ) -> list[str]:
        """Return the images of a drive; without any, and without returns, one that is gone."""
        files: list[Path] = []
        with suppress(OSError):  # the disk cannot list them: then none can be checked
            files = entries(self._layout.images(map_id, drive_id))
        found = sorted(self._path(path) for path in files if is_image_file_name(path.name))
        if not found and lacks_returns(drive_id):
            return [self._path(self._layout.images(map_id, drive_id) / ANY_IMAGES)]
        return found

    def _path(self, path: object) -> str:
        return str(path).removeprefix(f"{self._layout.data_dir}/")


def _of_scans(path: str, records: Sequence[ScanRecord]) -> StoredFile:
    return StoredFile(
        path,
        {record.row: record.digest for record in records},
        {record.row: record.index for record in records},
    )
