"""The database under the catalog: how it is opened and what a transaction is."""

import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.exc import DBAPIError, IntegrityError, SQLAlchemyError
from sqlalchemy.orm import Session, sessionmaker

from storage.catalog import audit_chain
from storage.catalog.acts import current_act
from storage.catalog.migrations import is_newest, upgrade
from storage.errors import (
    StorageBusy,
    StorageError,
    StorageFull,
    StorageReadOnly,
    StorageUnavailable,
)

__all__ = ["Database"]

_BUSY_TIMEOUT_S = 30  # of another process's transaction; ours take milliseconds

_NAMED: dict[int, type[StorageError]] = {
    sqlite3.SQLITE_BUSY: StorageBusy,
    sqlite3.SQLITE_FULL: StorageFull,
    sqlite3.SQLITE_READONLY: StorageReadOnly,
    # What WAL mode says on a read-only mount, where it cannot make its files.
    sqlite3.SQLITE_CANTOPEN: StorageReadOnly,
}


class Database:
    """Transactions on one database, from any thread; each process opens its own.

    SQLite in WAL mode: readers never wait, one writer at a time, a commit is on disk before it
    returns (`synchronous=FULL`).
    """

    def __init__(self, url: str, migrating: AbstractContextManager[object]) -> None:
        self.engine = create_engine(url, pool_size=16, max_overflow=32)
        self._writer: AbstractContextManager[object] = nullcontext()
        if self.engine.dialect.name == "sqlite":
            # Threads queue here and not in SQLite, which polls: as many commits a second, but with
            # 16 writers the slowest of 600 waits 0.2 s instead of 0.7 s (two cores).
            self._writer = threading.Lock()
            event.listen(self.engine, "connect", _prepare_sqlite)
            event.listen(self.engine, "begin", _begin_sqlite)
            _enter_wal_mode(self.engine)
        writing_engine = self.engine.execution_options(tensormap_writes=True)
        self._new_writer = sessionmaker(writing_engine)
        with _named_errors(), self.engine.connect() as connection:
            newest = is_newest(connection)
        if not newest:
            with (
                migrating,
                _named_errors(),
                self._writer,
                writing_engine.begin() as connection,
            ):
                upgrade(connection)

    @contextmanager
    def reading(self) -> Iterator[Session]:
        """Give a session on one consistent snapshot."""
        with _named_errors(), Session(self.engine) as session:
            yield session

    @contextmanager
    def writing(self) -> Iterator[Session]:
        """Give a session that commits when the block ends and rolls back when it raises.

        On SQLite no other writer comes between its reads and its writes. What is done on behalf of
        an `Act` is in the audit log with the same commit.

        Raises:
            StorageBusy: If another process held the database for too long.
            StorageFull: If no space is left; nothing is changed.
            StorageReadOnly: If the database cannot be written.
            StorageUnavailable: If the database fails or cannot be reached.
        """
        act = current_act()
        with _named_errors(), self._writer, self._new_writer.begin() as session:
            yield session
            if act is not None and not act.recorded:
                audit_chain.append(session, act, audit_chain.DONE)
        if act is not None:
            act.recorded = True

    def close(self) -> None:
        """Close the idle connections."""
        self.engine.dispose()


def _prepare_sqlite(connection: sqlite3.Connection, _record: object) -> None:
    # Python's driver opens transactions lazily and none for DDL; we begin them ourselves.
    connection.isolation_level = None
    connection.execute(f"PRAGMA busy_timeout = {_BUSY_TIMEOUT_S * 1000}")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("PRAGMA foreign_keys = ON")


def _enter_wal_mode(engine: Engine) -> None:
    # A mode of the file, for good. Of two that change it at once one is told that it is busy,
    # without regard to the busy timeout.
    deadline = time.monotonic() + _BUSY_TIMEOUT_S
    with _named_errors(), closing(engine.raw_connection()) as connection:
        while True:
            try:
                connection.cursor().execute("PRAGMA journal_mode = WAL")
            except sqlite3.OperationalError as error:
                if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > deadline:
                    raise
                time.sleep(0.01)
            else:
                return


def _begin_sqlite(connection: Connection) -> None:
    # IMMEDIATE: a transaction that reads first and then asks for the write lock would fail at
    # once if another one committed in between, whatever the busy timeout.
    writes = connection.get_execution_options().get("tensormap_writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


@contextmanager
def _named_errors() -> Iterator[None]:
    try:
        yield
    except IntegrityError:
        raise  # two writers met: who wrote knows what that means
    except (SQLAlchemyError, sqlite3.Error) as error:
        cause = error.orig if isinstance(error, DBAPIError) else error
        code = getattr(cause, "sqlite_errorcode", None)
        named = _NAMED.get(code & 0xFF, StorageUnavailable) if code else StorageUnavailable
        raise named(f"the catalog cannot be used: {cause or error}") from error
