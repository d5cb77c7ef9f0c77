"""Saved tracks: what a process needs to go on with the tracks of another one that ended.

Their rows live for minutes and change each second. So they are no part of the catalog: on SQLite
they are in a file of their own, since each commit to the catalog would discard what answers keep of
it, and no migration changes their table. One that has another form has another name.
"""

import logging
import sqlite3
from collections.abc import Collection, Iterable
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from sqlalchemy import (
    JSON,
    Column,
    Connection,
    Double,
    Integer,
    MetaData,
    Row,
    Table,
    bindparam,
    delete,
    insert,
    inspect,
    make_url,
    or_,
    select,
    text,
    update,
)
from sqlalchemy.exc import DBAPIError

from storage.catalog.acts import on_behalf
from storage.catalog.columns import Digest, Id, UtcDateTime
from storage.catalog.database import Database
from storage.catalog.kept import Kept
from storage.catalog.migrations import Schema
from storage.catalog.pages import one_more, page_of
from storage.catalog.records import Page
from storage.errors import StorageUnavailable

_LOCK = 7_665_108  # any number; only the making of this table asks PostgreSQL for it

_DAMAGE = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_ASIDE = ".damaged"
_SUFFIXES = ("", "-wal", "-shm")

_log = logging.getLogger("tensormap.storage")

_TRACKS = Table(
    "running_tracks_1",
    MetaData(),
    Column("id", Id, primary_key=True),
    Column("map_id", Id, nullable=False, index=True),
    Column("key_id", Id, nullable=False),
    Column("revision", Digest, nullable=False),
    Column("created_at", UtcDateTime, nullable=False),
    Column("used_s", Double, nullable=False),
    Column("observed_s", Double),
    Column("observations", Integer, nullable=False),
    Column("state", JSON(none_as_null=True)),
    Column("last", JSON(none_as_null=True)),
)
_COLUMNS = _TRACKS.columns
# Made once: fifty tracks are saved each second, and threads that answer wait meanwhile.
_UPDATE = (
    update(_TRACKS)
    .where(_COLUMNS.id == bindparam("saved_id"))
    .where(_COLUMNS.observations == bindparam("saved_observations"))
    .returning(_COLUMNS.id)
)


@dataclass(frozen=True)
class SavedTrack:
    """A track as it is saved.

    Attributes:
        id: The track's name.
        map_id: The id of the track's map.
        key_id: The id of the key that created it.
        revision: Digest of the revision that it stays in.
        created_at: When it was created.
        used_s: Unix time of its last use.
        observed_s: The time of its last observation, `None` before the first.
        observations: How many it has had.
        state: What continues it, in plain values.
        last: The track's last answer, `None` before the first observation.
    """

    id: str
    map_id: str
    key_id: str
    revision: str
    created_at: datetime
    used_s: float
    observed_s: float | None = None
    observations: int = 0
    state: dict[str, Any] | None = None
    last: dict[str, Any] | None = None


class _TracksDatabase(Database):
    """The database of the saved tracks, which has the rules of the catalog's."""

    def _schema(self, connection: Connection) -> Schema:
        return Schema.NEWEST if inspect(connection).has_table(_TRACKS.name) else Schema.NONE

    def require_integrity(self) -> None:
        """Raise `StorageUnavailable`, without a cause, if SQLite finds that its file is damaged."""
        with self.reading() as session:
            found = session.scalars(text("PRAGMA integrity_check")).all()
        if found != ["ok"]:
            raise StorageUnavailable(f"the file of tracks is damaged: {found[0]}")

    def _upgrade(self, connection: Connection) -> None:
        if connection.dialect.name == "postgresql":  # of two that start at once the second waits
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
        _TRACKS.create(connection, checkfirst=True)


class SavedTracks:
    """The tracks of all processes of a service, each as its process saved it last.

    Args:
        url: The database's URL; a SQLite file that is damaged is renamed, and an empty one made.
        kept: The catalog's cache, which says where no query may be made.
    """

    def __init__(self, url: str, kept: Kept) -> None:
        path = make_url(url).database if url.startswith("sqlite") else None
        try:
            self._database = _opened(path, url)
        except StorageUnavailable as error:
            if path is None or not _is_damage(error):
                raise
            _log.exception("%s is damaged and is set aside: its tracks are gone", path)
            for suffix in _SUFFIXES:
                with suppress(FileNotFoundError):
                    Path(path + suffix).replace(f"{path}{_ASIDE}{suffix}")
            self._database = _opened(path, url)
        self._database.kept = kept

    def add(self, track: SavedTrack, idle_since_s: float, instead_of: Collection[str] = ()) -> None:
        """Save a new track and remove others: all or nothing.

        Args:
            track: The new one.
            idle_since_s: Unix time; those that were used last before it are removed.
            instead_of: The ids of others to remove.
        """
        with on_behalf(None), self._database.writing(announced=False) as session:
            removed = or_(_COLUMNS.used_s < idle_since_s, _COLUMNS.id.in_(instead_of))
            session.execute(delete(_TRACKS).where(removed))
            session.execute(insert(_TRACKS), vars(track))

    def update(self, tracks: Iterable[tuple[int, SavedTrack]]) -> set[str]:
        """Save tracks that changed, each with the number of observations that it was saved with.

        Returns:
            The ids of those that are not saved: they were removed, or another process has gone on
            with them since.
        """
        lost = set()
        with on_behalf(None), self._database.writing(announced=False) as session:
            for before, track in tracks:
                saved = {"saved_id": track.id, "saved_observations": before}
                if session.execute(_UPDATE, vars(track) | saved).first() is None:
                    lost.add(track.id)
        return lost

    def remove(self, track_id: str) -> None:
        """Remove a track, if it is there."""
        with on_behalf(None), self._database.writing(announced=False) as session:
            session.execute(delete(_TRACKS).where(_COLUMNS.id == track_id))

    def remove_of_map(self, map_id: str) -> None:
        """Remove all tracks of a map."""
        with on_behalf(None), self._database.writing(announced=False) as session:
            session.execute(delete(_TRACKS).where(_COLUMNS.map_id == map_id))

    def get(self, track_id: str) -> SavedTrack | None:
        """Return a track, `None` if there is none of that name."""
        with self._database.reading() as session:
            found = session.execute(select(_TRACKS).where(_COLUMNS.id == track_id)).one_or_none()
        return None if found is None else _saved(found)

    def used_since(self, used_s: float) -> tuple[SavedTrack, ...]:
        """Return all tracks that were used at or after a Unix time, without state and answer."""
        columns = [c for c in _COLUMNS if c.name not in {"state", "last"}]
        with self._database.reading() as session:
            return tuple(
                map(_saved, session.execute(select(*columns).where(_COLUMNS.used_s >= used_s)))
            )

    def page(
        self, map_id: str, after: str, limit: int, *, used_since_s: float, key_id: str | None = None
    ) -> Page[SavedTrack]:
        """Return the tracks of a map, or of a key in it, in the order of their names.

        Args:
            map_id: The map.
            after: The name before the page; it need not be there any more.
            limit: Number of tracks in a page.
            used_since_s: Unix time of the last use from which on a track is listed.
            key_id: The id of the key that created them; all keys without it.
        """
        query = select(_TRACKS).where(
            _COLUMNS.map_id == map_id, _COLUMNS.id > after, _COLUMNS.used_s >= used_since_s
        )
        if key_id is not None:
            query = query.where(_COLUMNS.key_id == key_id)
        with self._database.reading() as session:
            rows = session.execute(query.order_by(_COLUMNS.id).limit(one_more(limit))).all()
        return page_of(list(map(_saved, rows)), limit, lambda track: track.id)

    def close(self) -> None:
        """Close the idle connections."""
        self._database.engine.dispose()


def _opened(path: str | None, url: str) -> Database:
    if path is not None:
        Path(path).touch(0o600)  # SQLite would make it readable by others
    database = _TracksDatabase(url, lambda _: nullcontext())
    if path is not None:
        try:
            database.require_integrity()
        except BaseException:
            database.engine.dispose()
            raise
    return database


def _is_damage(error: StorageUnavailable) -> bool:
    """Return whether a file is damaged: a disk that fails once, or is full, may not be.

    The driver cannot decode some of SQLite's messages about a damaged file.
    """
    cause = error.__cause__
    if isinstance(cause, DBAPIError):
        cause = cause.orig
    code = getattr(cause, "sqlite_errorcode", 0) & 0xFF
    return cause is None or isinstance(cause, UnicodeDecodeError) or code in _DAMAGE


def _saved(row: Row[Any]) -> SavedTrack:
    return SavedTrack(**row._mapping)
