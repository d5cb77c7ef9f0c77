"""Revisions in the catalog, and which of a map's is live."""

from datetime import UTC, datetime

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from storage.catalog.database import Repository
from storage.catalog.jobs import finish_if_running
from storage.catalog.maps import locked_map, map_named, map_of_id
from storage.catalog.models import LiveRevision, Map, Revision, RevisionBasis
from storage.catalog.pages import DEFAULT_LIMIT, page_by_age
from storage.catalog.records import Page, RevisionFacts, RevisionRecord, record_of
from storage.catalog.scans import LostRace
from storage.errors import (
    AmbiguousRevision,
    NoLiveRevision,
    RevisionIsLive,
    RevisionNotFound,
)

_SHORTEST_PREFIX = 12  # hex digits; 48 bits, a clash among a million revisions is 1 in 500


class Revisions(Repository):
    """The revisions of each map, newest first."""

    def add(
        self,
        map_id: str,
        digest: str,
        file_name: str,
        size_bytes: int,
        facts: RevisionFacts,
        *,
        make_live: bool = False,
        if_live: str | None = None,
    ) -> RevisionRecord:
        """Add a revision whose file is on disk; the first one of a map becomes live.

        A digest that the map has already keeps its record: its `file_name` then is another. The
        job that built it is done with the same commit: it never ends otherwise once this is true.

        Raises:
            MapNotFound: If the map is gone.
            LostRace: If another revision than `if_live` is live, and that was given; nothing is
                changed. Empty means that none is.
        """
        with self._database.writing() as session:
            of_map = map_of_id(session, map_id, lock=True)
            live = session.get(LiveRevision, of_map.id)
            if if_live is not None and if_live != (live.digest if live else ""):
                raise LostRace(f"another revision of {of_map.slug!r} became live meanwhile")
            row = session.get(Revision, (of_map.id, digest))
            now = datetime.now(UTC)
            if row is None:
                row = Revision(
                    map_id=of_map.id,
                    digest=digest,
                    file_name=file_name,
                    encoding=facts.encoding,
                    scans=facts.scans,
                    segments=facts.segments,
                    parameters=dict(facts.parameters),
                    size_bytes=size_bytes,
                    job_id=facts.job_id,
                    created_at=now,
                )
                session.add(row)
            row.retained_from = now
            if facts.drive_ids:
                row.drive_ids = dict(facts.drive_ids)
            session.flush()
            for basis in facts.bases:  # also of one from before they were written down
                session.merge(RevisionBasis(map_id=of_map.id, basis=basis, digest=digest))
            session.flush()
            if make_live or live is None:
                _make_live(session, of_map, digest)
            if facts.job_id is not None:
                finish_if_running(session, facts.job_id, digest, facts.notes, facts.job_result)
            return revision_record(row)

    def get(self, map_slug: str, digest: str) -> RevisionRecord:
        """Return a revision by its digest or a prefix of at least 12 digits that only it has.

        Raises:
            MapNotFound: If there is no such map.
            RevisionNotFound: If the map has no such revision, or the prefix is shorter.
            AmbiguousRevision: If the map has several.
        """
        with self._database.reading() as session:
            return revision_record(_found(session, map_named(session, map_slug), digest))

    def of_map(self, map_id: str, digest: str) -> RevisionRecord:
        """Return a revision of the map of that id, whatever its slug names now; else as `get`.

        Raises:
            MapNotFound: If the map is gone.
            RevisionNotFound: If it has no such revision, or the prefix is shorter than 12 digits.
            AmbiguousRevision: If it has several.
        """
        with self._database.reading() as session:
            return revision_record(_found(session, map_of_id(session, map_id), digest))

    def with_basis(self, map_slug: str, basis: str) -> RevisionRecord | None:
        """Return the revision that answers to a basis: the live one or else the newest.

        `None` if there is none.

        Args:
            map_slug: The map.
            basis: Its digest or a prefix of at least 12 digits.

        Raises:
            MapNotFound: If there is no such map.
        """
        wanted = basis.lower()
        with self._database.reading() as session:
            of_map = map_named(session, map_slug)
            if len(wanted) < _SHORTEST_PREFIX:
                return None
            held = select(RevisionBasis.digest).where(
                RevisionBasis.map_id == of_map.id,
                RevisionBasis.basis.startswith(wanted, autoescape=True),
            )
            row = session.scalar(
                select(Revision)
                .outerjoin(
                    LiveRevision,
                    (LiveRevision.map_id == Revision.map_id)
                    & (LiveRevision.digest == Revision.digest),
                )
                .where(Revision.map_id == of_map.id, Revision.digest.in_(held))
                .order_by(
                    LiveRevision.digest.is_(None),
                    Revision.created_at.desc(),
                    Revision.digest.desc(),
                )
                .limit(1)
            )
            return None if row is None else revision_record(row)

    def live(self, map_slug: str) -> RevisionRecord:
        """Return the live revision.

        Raises:
            MapNotFound: If there is no such map.
            NoLiveRevision: If it has none yet.
        """
        with self._database.reading() as session:
            of_map = map_named(session, map_slug)
            live = session.get(LiveRevision, of_map.id)
            if live is None:
                raise NoLiveRevision(f"map {map_slug!r} has no revision yet: build one")
            return revision_record(_found(session, of_map, live.digest))

    def list(
        self, map_slug: str, after: str = "", limit: int = DEFAULT_LIMIT
    ) -> Page[RevisionRecord]:
        """Return the revisions that are older than the one of digest `after`.

        Raises:
            MapNotFound: If there is no such map.
            InvalidParameters: If `after` is none of its revisions.
        """
        with self._database.reading() as session:
            map_id = map_named(session, map_slug).id
            query = select(Revision).where(Revision.map_id == map_id)
            name = Revision.digest
            return page_by_age(session, query, name, after, limit, revision_record, of_map=map_id)

    def set_live(
        self, map_slug: str, digest: str, *, if_version: int | None = None
    ) -> RevisionRecord:
        """Make a revision the live one; a change counts up the map's version.

        Raises:
            MapNotFound: If there is no such map.
            MapChanged: If its version is another than `if_version`.
            RevisionNotFound: If it has no such revision.
        """
        with self._database.writing() as session:
            of_map = locked_map(session, map_slug, if_version)
            row = _found(session, of_map, digest)
            _make_live(session, of_map, row.digest)
            return revision_record(row)

    def delete(self, map_slug: str, digest: str) -> RevisionRecord:
        """Remove a revision that is not live; return what it was.

        Raises:
            MapNotFound: If there is no such map.
            RevisionNotFound: If it has no such revision.
            RevisionIsLive: If it is the live one.
        """
        with self._database.writing() as session:
            of_map = locked_map(session, map_slug)
            row = _found(session, of_map, digest)
            live = session.get(LiveRevision, of_map.id)
            if live is not None and live.digest == row.digest:
                raise RevisionIsLive(f"revision {row.digest[:12]} is live: make another live first")
            record = revision_record(row)
            session.execute(
                delete(Revision).where(
                    Revision.map_id == of_map.id, Revision.digest == record.digest
                )
            )
            return record

    def size_bytes(self) -> int:
        """Return the size of all revisions of all maps together."""
        with self._database.reading() as session:
            return int(session.scalar(select(func.sum(Revision.size_bytes))) or 0)

    def files(self, map_id: str) -> dict[str, str]:
        """Return the digests of the revisions of a map, by the names of their files."""
        query = select(Revision.file_name, Revision.digest).where(Revision.map_id == map_id)
        with self._database.reading() as session:
            return {row.file_name: row.digest for row in session.execute(query)}


def _make_live(session: Session, of_map: Map, digest: str) -> None:
    live = session.get(LiveRevision, of_map.id)
    if live is None:
        session.add(LiveRevision(map_id=of_map.id, digest=digest))
    elif live.digest == digest:
        return
    else:
        replaced = session.get_one(Revision, (of_map.id, live.digest))
        replaced.retained_from = datetime.now(UTC)
        live.digest = digest
    of_map.version += 1
    session.flush()


def _found(session: Session, of_map: Map, digest: str) -> Revision:
    wanted = digest.lower()
    query = select(Revision).where(
        Revision.map_id == of_map.id, Revision.digest.startswith(wanted, autoescape=True)
    )
    rows = session.scalars(query.limit(2)).all() if len(wanted) >= _SHORTEST_PREFIX else ()
    if not rows:
        raise RevisionNotFound(f"map {of_map.slug!r} has no revision {digest[:80]!r}")
    if len(rows) > 1:
        raise AmbiguousRevision(f"several revisions of {of_map.slug!r} begin with {digest!r}")
    return rows[0]


def revision_record(row: Revision) -> RevisionRecord:
    """Return what a row says."""
    return record_of(RevisionRecord, row, drive_ids=row.drive_ids or {})
