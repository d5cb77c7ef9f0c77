"""Maps in the catalog."""

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from enum import Enum, auto
from typing import Any

from sqlalchemy import func, select, union_all
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from core.mapping.anchor import Anchor, AnchorFit
from storage.catalog import audit_chain
from storage.catalog.columns import plain
from storage.catalog.database import Repository
from storage.catalog.models import LiveRevision, Map, PurgedMap, Recycled
from storage.catalog.pages import DEFAULT_LIMIT, one_more, page_of
from storage.catalog.records import MapRecord, Page
from storage.errors import MapChanged, MapExists, MapNotFound
from storage.names import RECYCLED, checked_slug, is_recycled, new_id
from storage.retention import OwnRetention


class Keep(Enum):
    """No change of a value that may become `None`."""

    AS_IT_IS = auto()


class Maps(Repository):
    """The maps, in the order of their slugs."""

    def create(self, slug: str, description: str = "") -> MapRecord:
        """Make an empty map.

        Raises:
            InvalidSlug: If `slug` is not a valid slug.
            MapExists: If another map has it.
        """
        checked_slug(slug)
        with _named_taken(slug), self._database.writing() as session:
            _require_free(session, slug)
            row = Map(
                id=new_id(),
                slug=slug,
                description=plain(description),
                created_at=datetime.now(UTC),
                version=last_version(session, slug) + 1,
            )
            session.add(row)
            return _record(row, None)

    def get(self, slug: str) -> MapRecord:
        """Return a map.

        Raises:
            MapNotFound: If there is none of that slug.
        """

        def read() -> MapRecord:
            with self._database.reading() as session:
                row = map_named(session, slug)
                return map_record(session, row)

        return self._database.kept.get(("map", slug), read)

    def get_by_id(self, map_id: str) -> MapRecord:
        """Return a map by its id, whatever its slug is now.

        Raises:
            MapNotFound: If it is gone.
        """
        with self._database.reading() as session:
            row = map_of_id(session, map_id)
            return map_record(session, row)

    def list(
        self, after: str = "", limit: int = DEFAULT_LIMIT, *, slugs: Collection[str] | None = None
    ) -> Page[MapRecord]:
        """Return the maps whose slugs come after `after`, only those of `slugs` if given."""
        query = (
            select(Map, LiveRevision.digest)
            .outerjoin(LiveRevision, LiveRevision.map_id == Map.id)
            .where(Map.slug > after, Map.slug < RECYCLED)
            .order_by(Map.slug)
            .limit(one_more(limit))
        )
        if slugs is not None:
            query = query.where(Map.slug.in_(slugs))
        with self._database.reading() as session:
            rows = [_record(row, live) for row, live in session.execute(query)]
        return page_of(rows, limit, lambda record: record.slug)

    def update(
        self,
        slug: str,
        *,
        description: str | None = None,
        retention: Mapping[str, Any] | None = None,
        anchor: Anchor | Keep | None = Keep.AS_IT_IS,
        if_versions: Collection[int] | None = None,
        if_live: str | None = None,
    ) -> MapRecord:
        """Change what is given; a change increments the map's version.

        Args:
            slug: The map.
            description: The map's new description.
            retention: Changes of its `OwnRetention`; the rest of that stays.
            anchor: The map's new anchor, `None` to remove it.
            if_versions: Change it only if its version is one of these.
            if_live: Change it only if this revision is live.

        Raises:
            MapNotFound: If there is none of that slug.
            MapChanged: If its version is another, or another revision is live.
            InvalidParameters: If a value of `retention` is out of range.
        """
        with self._database.writing() as session:
            row = locked_map(session, slug, if_versions)
            if if_live is not None and if_live != _live(session, row):
                raise MapChanged(f"another revision of map {slug!r} became live meanwhile")
            if description is not None:
                row.description = plain(description)
            if retention is not None:
                chosen = replace(OwnRetention(**row.retention), **retention).chosen()
                if chosen != row.retention:
                    row.retention = chosen
            if anchor is not Keep.AS_IT_IS:
                row.anchor = None if anchor is None else _anchor_values(anchor)
            audit_chain.omit_if_unchanged(session, row)
            if session.is_modified(row):
                row.version += 1
            return map_record(session, row)


def map_named(session: Session, slug: str, *, lock: bool = False, shared: bool = False) -> Map:
    """Return the row of a map.

    Args:
        session: The transaction.
        slug: The map.
        lock: Lock the row against changes until the transaction ends.
        shared: Lock it against deletion only, so that writers who add to a map do not wait.

    Raises:
        MapNotFound: If there is none of that slug.
    """
    query = select(Map).where(Map.slug == slug)
    if lock or shared:
        query = query.with_for_update(read=shared, key_share=shared)
    row = session.scalar(query)
    if row is None or is_recycled(row.slug):
        raise no_map(slug)
    return row


def no_map(slug: str) -> MapNotFound:
    """Return the error for a slug that no map has."""
    return MapNotFound(f"there is no map {slug[:80]!r}")


def map_of_id(session: Session, map_id: str, *, lock: bool = False) -> Map:
    """Return the row of a map by its id, locked with `lock`, or raise `MapNotFound`."""
    row = session.get(Map, map_id, with_for_update=lock)
    if row is None or is_recycled(row.slug):
        raise MapNotFound(f"the map with id {map_id[:80]!r} is gone")
    return row


def locked_map(session: Session, slug: str, if_versions: Collection[int] | None = None) -> Map:
    """Return the row of a map, locked until the transaction ends.

    Raises:
        MapNotFound: If there is none of that slug.
        MapChanged: If its version is none of `if_versions`.
    """
    # SQLite has no FOR UPDATE: there the whole transaction holds the only write lock.
    row = map_named(session, slug, lock=True)
    if if_versions is not None and row.version not in if_versions:
        wanted = " or ".join(map(str, if_versions))
        raise MapChanged(f"map {slug!r} is at version {row.version}, not {wanted}")
    return row


def last_version(session: Session, slug: str) -> int:
    """Return the highest version of the deleted and purged maps of a name, 0 without any.

    Another map of that name goes on from it: else an ETag of theirs could be one of its own.
    """
    deleted = select(Map.version).join(Recycled, Recycled.id == Map.id).where(Recycled.slug == slug)
    purged = select(PurgedMap.version).where(PurgedMap.slug == slug)
    # In one query: a purge that ends takes a map from the one to the other.
    either = union_all(deleted, purged).subquery()
    return session.scalar(select(func.max(either.c.version))) or 0


@contextmanager
def _named_taken(slug: str) -> Iterator[None]:
    """Raise `MapExists` if another writer took the slug after the check."""
    try:
        yield
    except IntegrityError as error:
        raise MapExists(f"there is already a map {slug!r}") from error


def _require_free(session: Session, slug: str) -> None:
    if session.scalar(select(Map.id).where(Map.slug == slug)) is not None:
        raise MapExists(f"there is already a map {slug!r}")


def map_record(session: Session, row: Map) -> MapRecord:
    """Return the record of a map, as it is in a transaction."""
    return _record(row, _live(session, row))


def _live(session: Session, row: Map) -> str | None:
    return session.scalar(select(LiveRevision.digest).where(LiveRevision.map_id == row.id))


def _record(row: Map, live_revision: str | None) -> MapRecord:
    return MapRecord(
        row.id,
        row.slug,
        row.description,
        row.created_at,
        row.version,
        live_revision,
        OwnRetention(**row.retention),
        None if row.anchor is None else _anchor(row.anchor),
    )


def _anchor_values(anchor: Anchor) -> dict[str, Any]:
    """Return the plain values of an anchor; earlier releases read those of one that was set."""
    values = anchor.as_attributes()
    if anchor.fitted is None:
        del values["fitted"]
    return values


def _anchor(values: Mapping[str, Any]) -> Anchor:
    fitted = values.get("fitted")
    return Anchor(**{**values, "fitted": None if fitted is None else AnchorFit(**fitted)})
