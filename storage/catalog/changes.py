"""Whether anything in the catalog changed: a number that does not, or `None` if that is not known.

Every change that answers depend on is announced with its commit: on SQLite it is counted in the
database's header, on PostgreSQL a thread listens.
"""

import sqlite3
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, Protocol

from sqlalchemy import Engine, text
from sqlalchemy.orm import Session

CHANNEL = "tensormap_catalog"
"""PostgreSQL's channel; each database has its own."""

VALID_S = 1.0
"""How long what is kept may be used after the channel was heard last."""

_BEAT_S = 0.3  # between two checks that the channel still works
_RETRY_S = 1.0
_MOST_COUNTED = 2**31  # SQLite keeps it as a signed number of four bytes


class Changes(Protocol):
    """Detects changes of the catalog."""

    def version(self) -> int | None:
        """Return a number that changes with the catalog, `None` if it is not known now."""

    def changed(self) -> None:
        """Note that this process committed a change."""

    def close(self) -> None:
        """Stop."""


class SqliteChanges:
    """The number of changes in the database's header, read again after each commit of a process.

    SQLite's `data_version` says that there was one, on a connection of its own also of this
    process. Most are of scans that were stored, on which no answer depends and which leave the
    number as it is.

    Args:
        path: The database's path.
    """

    def __init__(self, path: str) -> None:
        # It never waits for another process: then the version is not known.
        self._connection = sqlite3.connect(
            path, timeout=0.0, isolation_level=None, check_same_thread=False
        )
        self._lock = threading.Lock()
        self._commit: int | None = None
        self._count = 0

    def version(self) -> int | None:
        """Return the number of changes; this takes microseconds."""
        try:
            with self._lock:
                commit = self._read("data_version")
                if commit != self._commit:
                    self._count, self._commit = self._read("user_version"), commit
                return self._count
        except sqlite3.Error:
            return None

    def changed(self) -> None:
        """Do nothing: the number was written with the change."""

    def close(self) -> None:
        """Close the connection."""
        with self._lock:
            self._connection.close()

    def _read(self, pragma: str) -> int:
        return int(self._connection.execute(f"PRAGMA {pragma}").fetchone()[0])


class PostgresqlChanges:
    """Counts announced changes; each loss of the channel is one too.

    Args:
        connect: Returns a new connection of psycopg, given more of its arguments.
    """

    def __init__(self, connect: Callable[..., Any]) -> None:
        self._connect = connect
        self._lock = threading.Lock()
        self._count = 0
        self._valid_until_s = 0.0
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="catalog changes", daemon=True)
        self._thread.start()

    def version(self) -> int | None:
        """Return the number of changes, `None` if the channel was not heard for a second."""
        with self._lock:
            return self._count if time.monotonic() < self._valid_until_s else None

    def changed(self) -> None:
        """Count a change of this process, before it is announced to it."""
        with self._lock:
            self._count += 1

    def close(self) -> None:
        """Stop listening."""
        self._closed.set()
        self._thread.join(_BEAT_S + _RETRY_S)

    def _listen(self) -> None:
        while not self._closed.is_set():
            # Whatever ends it: what is kept expires, and the catalog is queried.
            with suppress(Exception):
                self._listen_once()
            self._closed.wait(_RETRY_S)

    def _listen_once(self) -> None:
        with self._connect(autocommit=True, connect_timeout=5) as connection:
            connection.execute(f"LISTEN {CHANNEL}")
            self.changed()  # what happened before is not known
            while not self._closed.is_set():
                asked_s = time.monotonic()
                connection.execute("SELECT 1")
                with self._lock:
                    self._valid_until_s = asked_s + VALID_S
                for _ in connection.notifies(timeout=_BEAT_S):
                    self.changed()


def announce(session: Session) -> None:
    """Announce a change with the commit of its session."""
    if session.get_bind().dialect.name == "postgresql":
        session.execute(text(f"NOTIFY {CHANNEL}"))
        return
    count = session.scalar(text("PRAGMA user_version")) or 0
    session.execute(text(f"PRAGMA user_version = {(count + 1) % _MOST_COUNTED}"))


def changes_of(engine: Engine) -> Changes | None:
    """Return the detector of changes for an engine's database, `None` if there is none for it."""
    dialect, url = engine.dialect, engine.url
    if dialect.name == "sqlite":
        return SqliteChanges(url.database) if url.database else None
    if dialect.driver != "psycopg":  # of the others none reports notifications
        return None
    positional, named = dialect.create_connect_args(url)
    return PostgresqlChanges(partial(dialect.loaded_dbapi.connect, *positional, **named))
