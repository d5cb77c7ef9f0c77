"""The store of one data directory: the façade that the service uses."""

from pathlib import Path
from typing import Self

from storage.catalog import Catalog
from storage.files import make_folder
from storage.store.drives import Drives
from storage.store.layout import Layout
from storage.store.maps import Maps
from storage.store.recovery import ServerLock, sweep
from storage.store.revisions import Revisions

__all__ = ["Store"]


class Store:
    """Maps, drives, revisions, jobs and keys of one data directory.

    A write that returns is on disk, file and row: the file is written beside, fsynced and renamed
    first, then the row that names it is committed. A crash between the two leaves a file that no
    row names, never a row without its file. Files are never edited.

    Safe from many threads. Another process opens its own store on the same directory; only the
    server calls `recover`, once, before it serves.

    Args:
        data_dir: Where everything lies; it is made if it is not there.
        catalog_url: A SQLAlchemy URL; SQLite in the data directory by default.

    Attributes:
        maps: The maps.
        drives: Their drives and scans.
        revisions: What was built of them, and which is live.
        jobs: What is being built.
        keys: Who may ask for what.

    Examples:
        >>> import tempfile
        >>> from core.scan import Scan
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
        make_folder(self.layout.maps)
        self.catalog = Catalog(catalog_url or f"sqlite:///{self.layout.catalog}")
        self.maps = Maps(self.catalog, self.layout)
        self.drives = Drives(self.catalog, self.layout)
        self.revisions = Revisions(self.catalog, self.layout)
        self.jobs = self.catalog.jobs
        self.keys = self.catalog.keys
        self._lock = ServerLock(self.layout.lock)

    def recover(self) -> None:
        """Become the server of this data directory and clear up after the last one.

        Files that no row names are removed, and interrupted jobs are queued again.

        Raises:
            DataDirInUse: If another server runs on it.
        """
        self._lock.take()
        sweep(self.catalog, self.layout)
        self.jobs.requeue_interrupted()

    def close(self) -> None:
        """Close the catalog and let another server have the data directory."""
        self.catalog.close()
        self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
