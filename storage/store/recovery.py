"""What a server does at its start: own the data directory, and clear up after a crash."""

import fcntl
import os
import shutil
from pathlib import Path

from storage.catalog import Catalog
from storage.errors import DataDirInUse
from storage.files import remove_parts
from storage.store.layout import Layout

__all__ = ["ServerLock", "sweep"]


class ServerLock:
    """A lock on a file that ends with the process, however that ends."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor: int | None = None

    def take(self) -> None:
        """Take the lock; taking it twice is taking it once.

        Raises:
            DataDirInUse: If another process, or another store of this one, holds it.
        """
        if self._descriptor is not None:
            return
        descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(descriptor)
            raise DataDirInUse(f"another server runs on {self._path.parent}") from error
        self._descriptor = descriptor

    def release(self) -> None:
        """Give the lock back, if it is held."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


def sweep(catalog: Catalog, layout: Layout) -> None:
    """Remove what no row names: half-written files, orphans, folders of what was deleted.

    Only safe while nobody writes: a file is there before its row.
    """
    remove_parts(layout.maps)
    known = catalog.drives.known()
    maps = {map_id for map_id, _ in known}
    for folder in layout.maps.iterdir():
        if folder.name not in maps:
            shutil.rmtree(folder)
    for map_id in maps:
        _keep_only(layout.revisions(map_id), catalog.revisions.files(map_id))
        drives = {drive_id for of_map, drive_id in known if of_map == map_id}
        _keep_only(layout.map(map_id) / "drives", drives)
        for drive_id in drives:
            _keep_only(layout.chunks(map_id, drive_id), catalog.scans.chunks(drive_id))


def _keep_only(folder: Path, names: set[str]) -> None:
    for path in folder.iterdir() if folder.is_dir() else ():
        if path.name in names:
            continue
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
