"""The id of the data directory that the catalog belongs to."""

from collections.abc import Callable

from sqlalchemy import select, text

from storage.catalog.database import Repository
from storage.catalog.models import Map, RevisionRecord, Scan, StoreId

_ROW = 1


class StoreIds(Repository):
    """The id that a catalog shares with its data directory."""

    def get(self) -> str | None:
        """Return the id, `None` before the catalog's first use."""
        with self._database.reading() as session:
            return session.scalar(select(StoreId.id))

    def ensure(self, make: Callable[[], str]) -> str:
        """Return the id; a catalog without one gets what `make` returns, from one caller only."""
        with self._database.writing() as session:
            if session.get_bind().dialect.name == "postgresql":  # SQLite has one writer anyway
                session.execute(text("LOCK TABLE store IN EXCLUSIVE MODE"))
            row = session.get(StoreId, _ROW)
            if row is None:
                row = StoreId(row=_ROW, id=make())
                session.add(row)
            return row.id

    def in_use(self) -> bool:
        """Return whether the catalog has a map."""
        with self._database.reading() as session:
            return session.scalar(select(Map.id).limit(1)) is not None

    def has_files(self) -> bool:
        """Return whether the catalog names a file of a map that its backups have."""
        named = Scan.chunk, RevisionRecord.file_name
        with self._database.reading() as session:
            return any(session.scalar(select(of).limit(1)) is not None for of in named)
