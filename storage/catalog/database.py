"""The catalog's database: connections, transactions and named errors."""

import os
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Engine, create_engine, event, inspect, make_url, select
from sqlalchemy.exc import (
    ArgumentError,
    DBAPIError,
    IntegrityError,
    NoSuchModuleError,
    SQLAlchemyError,
)
from sqlalchemy.orm import Session, sessionmaker

from storage.catalog import audit_chain
from storage.catalog.acts import current_act
from storage.catalog.changes import announce, changes_of
from storage.catalog.kept import Kept
from storage.catalog.migrations import Schema, schema_of, upgrade
from storage.catalog.models import StoreId
from storage.errors import (
    StorageBusy,
    StorageError,
    StorageFull,
    StorageReadOnly,
    StorageUnavailable,
)
from storage.files.files import named_disk_errors

_BUSY_TIMEOUT_S = 30  # of the transactions of other processes
_WAIT_BUSY = f"PRAGMA busy_timeout = {_BUSY_TIMEOUT_S * 1000}"
# Parameters of libpq where the network drops packets, as for a host that is gone or a connection
# that a firewall forgot. By default a query waits 15 minutes, or two hours if it got there.
_NETWORK = {
    "connect_timeout": "10",
    "keepalives_idle": "10",
    "keepalives_interval": "5",
    "keepalives_count": "4",
    "tcp_user_timeout": "30000",  # ms
}

_NAMED: dict[int, type[StorageError]] = {
    sqlite3.SQLITE_BUSY: StorageBusy,
    sqlite3.SQLITE_FULL: StorageFull,
    sqlite3.SQLITE_READONLY: StorageReadOnly,
    # From WAL mode on a read-only mount, where it cannot make its files.
    sqlite3.SQLITE_CANTOPEN: StorageReadOnly,
    # Of a start on a full disk, where it makes the same files: an I/O error otherwise.
    sqlite3.SQLITE_IOERR_SHMSIZE: StorageFull,
}

# PostgreSQL's own codes: SQLSTATE.
_NAMED_STATES: dict[str, type[StorageError]] = {
    "40001": StorageBusy,  # serialization failure
    "40P01": StorageBusy,  # deadlock
    "55P03": StorageBusy,  # lock timeout
    "53300": StorageBusy,  # too many connections
    "53100": StorageFull,  # disk full
    "25006": StorageReadOnly,  # a standby, or default_transaction_read_only
}
# For everybody: the texts of the drivers name hosts, ports, users and files.
_PUBLIC: dict[type[StorageError], str] = {
    StorageBusy: "the catalog's database is busy: try again",
    StorageFull: "no space is left for the catalog's database: free some",
    StorageReadOnly: "the catalog's database or its folder cannot be written: make it writable",
    StorageUnavailable: (
        "the catalog's database fails or cannot be reached: check it and its connection"
    ),
}
# The last: the driver cannot decode SQLite's message about a damaged file.
_FAILURES = (SQLAlchemyError, sqlite3.Error, UnicodeDecodeError)
_BACKENDS = ("sqlite", "postgresql")

Migrating = Callable[[str | None], AbstractContextManager[object]]
"""Called with the id of the catalog's store, `None` if it has none, before anything is changed; an
error that it or its context raises leaves the database as it is."""


class Database:
    """Transactions on one database, from any thread; each process opens its own.

    SQLite in WAL mode: readers never wait, one writer at a time, a commit is on disk before it
    returns (`synchronous=FULL`). PostgreSQL: writers lock the rows that they change, in the order
    map, drive, job; each reading session has one snapshot.

    Args:
        url: A SQLAlchemy URL.
        migrating: Returns what is held while the schema is made or changed.

    Attributes:
        require_writable: Called before each commit; an error that it raises undoes the change.
    """

    def __init__(self, url: str, migrating: Migrating) -> None:
        self.engine = _engine(url)
        self.kept = Kept()
        self._reading_engine = self.engine
        self._writer: AbstractContextManager[object] = nullcontext()
        self._file: tuple[Path, os.stat_result] | None = None
        self.require_writable: Callable[[], None] = lambda: None
        if self.engine.dialect.name == "postgresql":
            event.listen(self.engine, "connect", _prepare_postgresql)
            event.listen(self.engine, "checkin", _forget_mode)
            self._reading_engine = self.engine.execution_options(
                isolation_level="REPEATABLE READ", postgresql_readonly=True
            )
        elif self.engine.dialect.name == "sqlite":
            self._writer = _OneWriter()
            event.listen(self.engine, "connect", _prepare_sqlite)
            event.listen(self.engine, "begin", _begin_sqlite)
        writing_engine = self.engine.execution_options(tensormap_writer=self._writer)
        # Records are used after the commit, detached.
        self._new_writer = sessionmaker(writing_engine, expire_on_commit=False)
        try:
            self._open(writing_engine, migrating)
        except BaseException:
            self.engine.dispose()
            raise

    def _open(self, writing_engine: Engine, migrating: Migrating) -> None:
        with _named_errors(), self.engine.connect() as connection:
            found = self._schema(connection)
            store_id = _store_id(connection) if found == Schema.OLDER else None
        with nullcontext() if found == Schema.NEWEST else migrating(store_id):
            if self.engine.dialect.name == "sqlite":
                _enter_wal_mode(self.engine)  # which changes the file: only now it is known as ours
            if found != Schema.NEWEST:
                with _named_errors(), self._writer, writing_engine.begin() as connection:
                    self._upgrade(connection)
        if self.engine.dialect.name == "sqlite":
            with _named_errors(), self.engine.connect() as connection:
                listed = connection.exec_driver_sql("PRAGMA database_list")
                path = next(Path(file) for _, name, file in listed if name == "main")
            with named_disk_errors():
                self._file = path, path.stat()

    def _schema(self, connection: Connection) -> Schema:
        return schema_of(connection)

    def _upgrade(self, connection: Connection) -> None:
        upgrade(connection)

    @contextmanager
    def reading(self) -> Iterator[Session]:
        """Yield a session on one consistent snapshot."""
        self.kept.require_query()
        with _named_errors(), Session(self._reading_engine) as session:
            yield session

    @contextmanager
    def writing(self, *, announced: bool = True) -> Iterator[Session]:
        """Yield a session that commits when the block ends and rolls back when it raises.

        On SQLite no other writer can write between its reads and its writes. A change on behalf of
        an `Act` is in the audit log with the same commit, unless it is known to change nothing.

        Args:
            announced: Whether it may change what `kept` has: not what is frequent and of no answer.

        Raises:
            StorageBusy: If another process held the database for too long.
            StorageFull: If no space is left; nothing is changed.
            StorageReadOnly: If the database cannot be written.
            StorageUnavailable: If the database fails or cannot be reached. If that happened in the
                commit, the change may have taken effect.
        """
        self.kept.require_query()
        act = current_act()
        with _named_errors(), self._writer, self._new_writer.begin() as session:
            yield session
            self.require_writable()
            logged = act is not None and not audit_chain.is_unchanged(session)
            if act is not None and logged and not act.recorded:
                audit_chain.append(session, act, audit_chain.DONE)
            if announced:
                announce(session)
        if announced:
            self.kept.changed()
        if act is not None and logged:
            act.recorded = True

    def is_in_place(self) -> bool:
        """Return whether a SQLite database is still the file that was opened.

        Open connections go on with the old file, where nobody finds what they commit.
        """
        if self._file is None:
            return True
        path, opened = self._file
        try:
            return os.path.samestat(opened, path.stat())
        except OSError:
            return False

    def watch(self) -> None:
        """Keep in memory what answers read, until the catalog changes."""
        self.kept.watch(changes_of(self.engine))

    def faults(self) -> list[str]:
        """Return what is wrong with a SQLite database, in words."""
        if self.engine.dialect.name != "sqlite":
            return []
        try:
            with self._reading_engine.connect() as connection:
                rows = connection.exec_driver_sql("PRAGMA integrity_check")
                found = [str(row[0]) for row in rows if row[0] != "ok"]
                broken = connection.exec_driver_sql("PRAGMA foreign_key_check").all()
        except _FAILURES as error:
            return [str(error)]
        return found + [f"a row of {row[0]} refers to none of {row[2]}" for row in broken]

    def close(self) -> None:
        """Close the idle connections."""
        self.kept.close()
        self.engine.dispose()


class _OneWriter:
    """The lock of the writers of a SQLite database in this process.

    Threads queue here and not in SQLite, which polls: as many commits a second, but of 16 writers
    the slowest of 600 waits 0.2 s instead of 0.7 s (two cores). The first of them waits for another
    process, and what it waits the others have waited too: else the k-th would wait k times that.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._past_s = 0.0  # for which threads have waited for another process
        self._since_s: float | None = None  # when the one that waits now began
        self._came_s = 0.0  # of `_waited_s`, when who holds the lock came

    def __enter__(self) -> None:
        came_s = self._waited_s
        self._lock.acquire()
        self._came_s = came_s

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    @property
    def _waited_s(self) -> float:
        since_s, past_s = self._since_s, self._past_s
        return past_s if since_s is None else past_s + time.monotonic() - since_s

    def begin(self, connection: Connection) -> None:
        """Begin a transaction that writes, within the time that is left.

        IMMEDIATE: a transaction that reads first and then requests the write lock would fail at
        once if another one committed in between, whatever the busy timeout.
        """
        left_s = _BUSY_TIMEOUT_S - (self._past_s - self._came_s)
        pragmas = connection.connection.cursor()  # SQLAlchemy takes longer than SQLite
        pragmas.execute(f"PRAGMA busy_timeout = {max(0, int(left_s * 1000))}")
        self._since_s = time.monotonic()
        try:
            connection.exec_driver_sql("BEGIN IMMEDIATE")
        finally:
            self._past_s, self._since_s = self._waited_s, None
            pragmas.execute(_WAIT_BUSY)


class Repository:
    """Base of the classes that read and write the rows of one noun."""

    def __init__(self, database: Database) -> None:
        self._database = database


def _engine(url: str) -> Engine:
    """Return an engine; an error does not repeat the URL, which may have a password."""
    try:
        parsed = make_url(url)
    except (ArgumentError, ValueError):  # the latter: its port is no number
        raise StorageUnavailable(
            "TENSORMAP_CATALOG_URL is not a database URL such as postgresql://user@host/database"
        ) from None
    if "@" in (parsed.host or ""):  # what is behind the first one would be shown as a host's name
        raise StorageUnavailable(
            "TENSORMAP_CATALOG_URL has an @ in its user or password: write it as %40"
        )
    backend = parsed.get_backend_name()
    if backend not in _BACKENDS:
        raise StorageUnavailable(
            f"the catalog cannot be a {backend} database, wanted {' or '.join(_BACKENDS)}"
        )
    if backend == "sqlite" and not _names_file(parsed):
        raise StorageUnavailable(
            "TENSORMAP_CATALOG_URL names no file: SQLite's is sqlite:////folder/catalog.sqlite3"
        )
    try:
        if parsed.get_driver_name() == "psycopg":  # also of a URL without one
            parsed = parsed.set(query={**_NETWORK, **parsed.query})
        # A connection that a restart of the database closed is replaced before it is used.
        return create_engine(
            parsed, pool_size=16, max_overflow=32, pool_pre_ping=backend != "sqlite"
        )
    except ModuleNotFoundError as error:
        raise StorageUnavailable(
            f"a {backend} catalog needs {error.name}: pip install -e '.[postgresql]' in a clone"
        ) from None
    except NoSuchModuleError as error:
        raise StorageUnavailable(f"there is no such driver of a catalog: {error}") from None


def _names_file(url: URL) -> bool:
    """Return whether a URL of SQLite names a file; a database in memory is of one connection."""
    name = url.database or ":memory:"
    return not url.host and ":memory:" not in name and url.query.get("mode") != "memory"


def _prepare_postgresql(connection: Any, _record: object) -> None:  # noqa: ANN401 - psycopg's own
    with connection.cursor() as cursor:
        cursor.execute(f"SET lock_timeout = '{_BUSY_TIMEOUT_S}s'")
        # A commit is on disk before it returns; a stricter setting of the server stays.
        cursor.execute(
            "SELECT set_config('synchronous_commit', 'on', false)"
            " WHERE current_setting('synchronous_commit') = 'off'"
        )
    connection.commit()


def _forget_mode(connection: Any, _record: object) -> None:  # noqa: ANN401 - psycopg's own
    # After a read-only session SQLAlchemy sets a connection to read-write, not to the server's
    # default: a database that is read-only by default would be written through it.
    if connection is not None:
        connection.read_only = None


def _store_id(connection: Connection) -> str | None:
    if not inspect(connection).has_table(StoreId.__tablename__):
        return None
    return connection.scalar(select(StoreId.id))


def _prepare_sqlite(connection: sqlite3.Connection, _record: object) -> None:
    # Python's driver opens transactions lazily and none for DDL; we begin them ourselves.
    connection.isolation_level = None
    connection.execute(_WAIT_BUSY)
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("PRAGMA foreign_keys = ON")


def _enter_wal_mode(engine: Engine) -> None:
    # A permanent mode of the file. Of two processes that set it at the same time, one gets
    # SQLITE_BUSY at once, whatever the busy timeout.
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
    writer = connection.get_execution_options().get("tensormap_writer")
    if writer is None:
        connection.exec_driver_sql("BEGIN")
    else:
        writer.begin(connection)


@contextmanager
def _named_errors() -> Iterator[None]:
    try:
        yield
    except IntegrityError:
        raise  # two writers conflict: the caller gives it a name
    except _FAILURES as error:
        kind = _name_of(error.orig if isinstance(error, DBAPIError) else error)
        raise kind(_PUBLIC[kind]) from error


def _name_of(cause: BaseException | None) -> type[StorageError]:
    code = getattr(cause, "sqlite_errorcode", None)
    if code is not None:
        return _NAMED.get(code) or _NAMED.get(code & 0xFF, StorageUnavailable)
    return _NAMED_STATES.get(getattr(cause, "sqlstate", None) or "", StorageUnavailable)
