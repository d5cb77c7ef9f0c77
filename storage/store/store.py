"""The store of one data directory: the façade that the service uses."""

import os
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Self

from storage.catalog import Catalog, SavedTracks
from storage.closing import Closing
from storage.errors import StorageUnavailable
from storage.files.files import make_folder, named_disk_errors
from storage.files.free_space import OF_SCANS, has_inodes
from storage.store.bases import Bases
from storage.store.captures import Captures
from storage.store.catalog_url import url_of, url_of_file
from storage.store.clock import ClockWatch
from storage.store.drives import Drives
from storage.store.held_folder import HeldFolder
from storage.store.identity import (
    check_identity,
    has_maps,
    prepare_folder,
    require_files,
    require_own_folder,
)
from storage.store.layout import Layout
from storage.store.leftovers import sweep
from storage.store.maps import Maps
from storage.store.permissions import make_private, require_owner
from storage.store.purges import Purges
from storage.store.recycle_bin import RecycleBin
from storage.store.revisions import Revisions
from storage.store.server_lock import ServerLock

_LEAST_FREE_BYTES = 2**20  # a scan of an HDL-64E has 1.5 million bytes


class Store(Closing):
    """Maps, drives, revisions, jobs and keys of one data directory.

    A write that returns is on disk, file and row: first the file is written under a temporary name,
    fsynced and renamed, then the row that names it is committed. A crash between the two leaves a
    file that no row names, never a row without its file. Files are never edited.

    Safe for many threads. Another process opens its own store on the same directory; only the
    server opens it with `Store.serving`. Opening upgrades the catalog's schema to the newest
    version, unless a server of another version runs. A directory that cannot be written, such as a
    snapshot, can be read.

    Args:
        data_dir: The data directory; it is made if it does not exist.
        catalog_url: A SQLAlchemy URL; SQLite in the data directory by default.

    Raises:
        DataDirInUse: If the catalog's schema is old and a server runs on it.
        WrongCatalog: If the catalog belongs to another data directory or program, or to a newer
            version.

    Attributes:
        maps: The maps.
        drives: The maps' drives and scans.
        revisions: The maps' revisions, and which is live.
        bases: The shared bases.
        recycle_bin: Deleted maps and drives.
        purges: Removes those that are purged.
        captures: Uploads of captures in parts.
        jobs: The maps' jobs.
        keys: The API keys.
        tokens: The tokens of keys.
        audit: The log of changes.
        clock: Whether the clock can be trusted to remove what is too old.

    Examples:
        >>> import tempfile
        >>> from core.scans.scan import Scan
        >>> store = Store(Path(tempfile.mkdtemp()))
        >>> _ = store.maps.create("campus")
        >>> scan = Scan.from_returns([[10.0, 0.0, 0.0]])
        >>> store.drives.put_scan("campus", "monday", 7, scan).created
        True
        >>> store.drives.put_scan("campus", "monday", 7, scan).created
        False
        >>> store.drives.read_scan("campus", "monday", 7).points_m.tolist()
        [[10.0, 0.0, 0.0]]
        >>> store.close()
    """

    def __init__(self, data_dir: Path, catalog_url: str | None = None) -> None:
        self.layout = Layout(data_dir.absolute())
        self.clock = ClockWatch(self.layout.clock)
        self._lock = ServerLock(self.layout.lock)
        self._held: tuple[HeldFolder, HeldFolder] | None = None  # the data directory, the maps
        prepare = partial(prepare_folder, self.layout, has_maps=has_maps(self.layout))
        if catalog_url is None and not self.layout.catalog.exists():
            prepare(None)
            with named_disk_errors():
                self.layout.catalog.touch(0o600)  # SQLite would make it readable by others
        url = catalog_url or url_of(self.layout.catalog)
        self._tracks_url = url_of_file(self.layout.tracks) if url.startswith("sqlite") else url

        def migrating(of_catalog: str | None) -> AbstractContextManager[None]:
            prepare(of_catalog)
            return self._lock.held()

        self.catalog = Catalog(url, migrating)
        try:
            check_identity(self.catalog, self.layout)
            make_folder(self.layout.maps)
        except BaseException:
            self.catalog.close()
            raise
        self.purges = Purges(self.catalog, self.layout)
        self.maps = Maps(self.catalog, self.purges)
        self.drives = Drives(self.catalog, self.layout, self.purges)
        self.revisions = Revisions(self.catalog, self.layout)
        self.bases = Bases(self.catalog, self.layout)
        self.recycle_bin = RecycleBin(self.catalog, self.purges)
        self.captures = Captures(self.catalog, self.layout)
        self.jobs = self.catalog.jobs
        self.keys = self.catalog.keys
        self.tokens = self.catalog.tokens
        self.audit = self.catalog.audit

    @classmethod
    def serving(cls, data_dir: Path, catalog_url: str | None = None) -> Self:
        """Open a store as its server: migrate, lock the directory, then recover.

        Raises:
            InvalidParameters: If it is a folder with other content, or of another user than root,
                who starts the service; nothing is changed.
            DataDirInUse: If another server runs on it; nothing is changed.
            StorageUnavailable: If the folder of the maps is empty, and the catalog names files in
                it; nothing is changed.
            WrongCatalog: If the catalog belongs to another data directory or program, or to a newer
                version; nothing is changed.
        """
        layout = Layout(data_dir.absolute())
        require_own_folder(layout)
        require_owner(layout)
        store = cls(data_dir, catalog_url)
        try:
            store.recover()
        except BaseException:
            store.close()
            raise
        return store

    def recover(self) -> None:
        """Become the server of this data directory and clean up after the last one.

        Files that no row names are moved to `orphans/`, and interrupted jobs are queued again.

        Raises:
            DataDirInUse: If another server runs on it.
            StorageUnavailable: If the folder of the maps is empty, and the catalog names files in
                it; nothing is changed.
        """
        self._lock.take()
        self.hold()
        make_private(self.layout)
        sweep(self.catalog, self.layout, self.clock)
        self.captures.forget_lost()
        self.jobs.requeue_interrupted()

    def hold(self) -> None:
        """Hold the folders, and reject changes while another is in the place of one.

        As a restored backup may be, or the mount point of a disk: the catalog would still be that
        of the folder before, and files would be written into the new one. For a process that
        stores something for long; a second call has no effect.

        Raises:
            StorageUnavailable: If the folder of the maps is empty, and the catalog names files in
                it; nothing is changed.
        """
        if self._held is None:
            require_files(self.catalog, self.layout)
            self._held = HeldFolder(self.layout.data_dir), HeldFolder(self.layout.maps)
            self.catalog.guard(self._require_in_place)

    def owned(self) -> AbstractContextManager[None]:
        """Own the data directory for a block, as a server does; one that owns it keeps it.

        Raises:
            DataDirInUse: If another server runs on it.
        """
        return self._lock.held()

    def saved_tracks(self) -> SavedTracks:
        """Open the tracks of this service and of its earlier processes; the caller closes them.

        On SQLite they are in a file of this data directory, else in the catalog's database.
        """
        return self.catalog.saved_tracks(self._tracks_url)

    def lacking(self) -> list[str]:
        """Return the reasons why the data directory cannot be written, none if it can."""
        if replaced := self._replaced():
            return [replaced]
        if not os.access(self.layout.maps, os.W_OK):
            return ["the data directory cannot be written"]
        disks = self.layout.of_disks if self.layout.has_catalog else (self.layout.maps,)
        free_bytes = min(map(OF_SCANS.left_bytes, disks))
        if free_bytes < _LEAST_FREE_BYTES:
            return [f"the data directory has {free_bytes} bytes left for scans, one needs more"]
        if not all(map(has_inodes, disks)):
            return ["the data directory's file system has no inode left for another file: `df -i`"]
        return []

    def _replaced(self) -> str | None:
        """Return what was moved or replaced since it is held, `None` if nothing was."""
        if self._held is not None:
            data_dir, maps = self._held
            if not data_dir.is_in_place():
                return "the data directory was moved or replaced"
            if not maps.is_in_place():  # of another disk, perhaps
                return "the folder of the maps was moved, replaced or unmounted"
        if not self.catalog.is_in_place():
            return "the catalog's file was moved or replaced"
        return None

    def _require_in_place(self) -> None:
        """Reject what nobody would find after the next start.

        Raises:
            StorageUnavailable: If the data directory, the folder of the maps or the catalog was
                moved or replaced.
        """
        if replaced := self._replaced():
            raise StorageUnavailable(
                f"{replaced} while the service runs: stop it, and start it on the right one"
            )

    def stored_bytes(self) -> dict[str, int]:
        """Return the size of all raw returns, `scans`, and of the files of all `revisions`.

        What is in the recycle bin counts: it takes space until it is removed.
        """
        return {
            "scans": self.catalog.scans.size_bytes(),
            "revisions": self.catalog.revisions.size_bytes(),
        }

    def close(self) -> None:
        """Close the catalog and release the data directory."""
        try:
            self.catalog.close()
        finally:
            self._lock.release()
            for folder in self._held or ():
                folder.release()
            self._held = None
