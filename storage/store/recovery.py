"""What a server does at its start: own the data directory, and clear up after a crash."""

import fcntl
import logging
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from storage.catalog import Catalog
from storage.errors import DataDirInUse
from storage.files import make_folder, remove_parts
from storage.names import new_id
from storage.store.layout import Layout

__all__ = ["ServerLock", "sweep"]

_log = logging.getLogger("tensormap.storage")


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
        descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
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

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the lock for a block, or go on holding it.

        Raises:
            DataDirInUse: If another process, or another store of this one, holds it.
        """
        was_held = self._descriptor is not None
        self.take()
        try:
            yield
        finally:
            if not was_held:
                self.release()


def sweep(catalog: Catalog, layout: Layout) -> None:
    """Remove half-written files, and move what no row names to `orphans/`, under its old path.

    Mostly that is what a crash left. Should the catalog be at fault, as after a partial restore,
    nothing is lost.

    Only safe while nobody writes: a file is there before its row.
    """
    remove_parts(layout.maps)
    orphans = list(_unnamed(catalog, layout))
    for path in orphans:
        aside = layout.orphans / path.relative_to(layout.data_dir)
        make_folder(aside.parent)
        if aside.exists():
            aside = aside.with_name(f"{aside.name}.{new_id()[:8]}")
        shutil.move(path, aside)
    if orphans:
        _log.warning(
            "%d files or folders that the catalog does not name were moved to %s",
            len(orphans),
            layout.orphans,
        )


def _unnamed(catalog: Catalog, layout: Layout) -> Iterator[Path]:
    known = catalog.drives.known()
    maps = {map_id for map_id, _ in known}
    yield from _others(layout.maps, maps)
    for map_id in maps:
        yield from _others(layout.revisions(map_id), catalog.revisions.files(map_id))
        drives = {drive_id for of_map, drive_id in known if of_map == map_id}
        yield from _others(layout.map(map_id) / "drives", drives)
        for drive_id in drives:
            yield from _others(layout.chunks(map_id, drive_id), catalog.scans.chunks(drive_id))


def _others(folder: Path, names: set[str]) -> Iterator[Path]:
    for path in folder.iterdir() if folder.is_dir() else ():
        if path.name not in names:
            yield path
