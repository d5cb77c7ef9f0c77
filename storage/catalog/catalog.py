"""One catalog: its database and a repository for each noun."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import TypeVar

from storage.catalog.audit import Audit
from storage.catalog.bases import Bases
from storage.catalog.captures import Captures
from storage.catalog.collection import Collector
from storage.catalog.database import Database, Migrating
from storage.catalog.drives import Drives
from storage.catalog.jobs import Jobs
from storage.catalog.keys import Keys
from storage.catalog.map_summaries import MapSummaries
from storage.catalog.maps import Maps
from storage.catalog.poses import Poses
from storage.catalog.purges import Purges
from storage.catalog.recycle_bin import RecycleBin
from storage.catalog.revisions import Revisions
from storage.catalog.saved_tracks import SavedTracks
from storage.catalog.scans import Scans
from storage.catalog.store_id import StoreIds
from storage.catalog.tokens import Tokens

T = TypeVar("T")


class Catalog:
    """Facts about maps, drives, scans, revisions, jobs and keys, and the log of changes.

    Opening one brings its schema to the newest revision. It is safe from any thread; a process
    that was forked opens its own.

    Args:
        url: A SQLAlchemy URL, as `sqlite:////var/lib/tensormap/catalog.sqlite3`.
        migrating: Called with the id of the catalog's store, `None` if it has none, before the
            schema is made or changed; returns what is held meanwhile. It is not called if the
            schema is the newest already. An error that it raises leaves the database as it is.

    Raises:
        WrongCatalog: If the database is of another program, or of a newer version.
    """

    def __init__(self, url: str, migrating: Migrating = lambda _: nullcontext()) -> None:
        self._database = Database(url, migrating)
        self.store_id = StoreIds(self._database)
        self.maps = Maps(self._database)
        self.map_summaries = MapSummaries(self._database)
        self.drives = Drives(self._database)
        self.scans = Scans(self._database)
        self.poses = Poses(self._database)
        self.revisions = Revisions(self._database)
        self.bases = Bases(self._database)
        self.recycle_bin = RecycleBin(self._database)
        self.purges = Purges(self._database)
        self.collector = Collector(self._database)
        self.captures = Captures(self._database)
        self.jobs = Jobs(self._database)
        self.keys = Keys(self._database)
        self.tokens = Tokens(self._database)
        self.audit = Audit(self._database)

    def watch(self) -> None:
        """Keep in memory what answers read, until the catalog changes; for a process that answers.

        What another process changes is seen at once on SQLite, and within a second on PostgreSQL.
        """
        self._database.watch()

    def guard(self, require_writable: Callable[[], None]) -> None:
        """Call a function before each commit; an error that it raises undoes the change."""
        self._database.require_writable = require_writable

    def require_writable(self) -> None:
        """Raise what a change would be rejected with by `guard`."""
        self._database.require_writable()

    def is_in_place(self) -> bool:
        """Return whether the file of a SQLite catalog is still the one that was opened."""
        return self._database.is_in_place()

    def saved_tracks(self, url: str) -> SavedTracks:
        """Open the tracks that are saved beside the catalog; whoever opens them closes them."""
        return SavedTracks(url, self._database.kept)

    def kept_by_digest(self, name: tuple[str, ...], digest: str, read: Callable[[], T]) -> T:
        """Return what `read` makes of the catalog; it is kept by that digest until a change.

        Of a digest that is abbreviated otherwise than in a packed signature it is not kept.
        """
        return self._database.kept.by_digest(name, digest, read)

    def kept_only(self) -> AbstractContextManager[None]:
        """Raise `NotKept` within the block, in this thread, where a query would be needed."""
        return self._database.kept.only()

    def faults(self) -> list[str]:
        """Return descriptions of the faults of the database itself, none if it is sound.

        Only of SQLite: PostgreSQL has tools of its own.
        """
        return self._database.faults()

    def close(self) -> None:
        """Close the idle connections."""
        self._database.close()
