"""Revisions in the catalog, and which of a map's is live."""

from collections.abc import Collection
from datetime import UTC, datetime

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from storage.catalog.audit_chain import add_to_detail
from storage.catalog.database import Repository
from storage.catalog.jobs import finish_if_running
from storage.catalog.maps import locked_map, map_named, map_of_id, map_record
from storage.catalog.models import LiveRevision, Map, RevisionBasis, RevisionRecord
from storage.catalog.pages import DEFAULT_LIMIT, page_by_age
from storage.catalog.records import MapRecord, Page, RevisionFacts
from storage.errors import (
    AmbiguousRevision,
    LostRace,
    NoLiveRevision,
    RevisionIsLive,
    RevisionNotFound,
)
from storage.names import FEWEST_DIGITS


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

        A digest that the map has already keeps its record: its `file_name` then is another. One
        that was imported gets the job and the parameters of a build here, since builds on it go by
        them. The job that built it is done with the same commit, and cannot end otherwise after
        that.

        Raises:
            MapNotFound: If the map is gone.
            LostRace: If `if_live` is given and another revision is live; nothing is changed. Empty
                means that none may be live.
        """
        with self._database.writing() as session:
            of_map = map_of_id(session, map_id, lock=True)
            live = session.get(LiveRevision, of_map.id)
            if if_live is not None and if_live != (live.digest if live else ""):
                raise LostRace(f"another revision of {of_map.slug!r} became live meanwhile")
            now = datetime.now(UTC)
            row = session.get(RevisionRecord, (of_map.id, digest))
            if row is None:
                numbers = select(func.max(RevisionRecord.number))
                last = session.scalar(numbers.where(RevisionRecord.map_id == of_map.id)) or 0
                row = RevisionRecord(
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
                    number=last + 1,
                )
                session.add(row)
            elif row.job_id is None and facts.job_id is not None:
                row.job_id, row.parameters = facts.job_id, dict(facts.parameters)
            row.retained_from = now
            if facts.drive_ids:
                row.drive_ids = dict(facts.drive_ids)
            session.flush()
            for basis in facts.bases:  # also of a revision of a version that did not store them
                session.merge(RevisionBasis(map_id=of_map.id, basis=basis, digest=digest))
            if (make_live or live is None) and _make_live(session, of_map, digest):
                add_to_detail(session, "made live")
            if facts.job_id is not None:
                finish_if_running(session, facts.job_id, digest, facts)
            return row

    def get(self, map_slug: str, digest: str) -> RevisionRecord:
        """Return a revision by its digest or a prefix of at least 12 digits that only it has.

        Raises:
            MapNotFound: If there is no such map.
            RevisionNotFound: If the map has no such revision, or the prefix is shorter than that.
            AmbiguousRevision: If the map has several.
        """

        def read() -> RevisionRecord:
            with self._database.reading() as session:
                return _found(session, map_named(session, map_slug), digest)

        return self._database.kept.by_digest(("revision", map_slug), digest, read)

    def of_map(self, map_id: str, digest: str) -> RevisionRecord:
        """Return a revision of the map of that id, whatever its slug is now; otherwise as `get`.

        Raises:
            MapNotFound: If the map is gone.
            RevisionNotFound: If it has no such revision, or the prefix is shorter than 12 digits.
            AmbiguousRevision: If it has several.
        """
        with self._database.reading() as session:
            return _found(session, map_of_id(session, map_id), digest)

    def with_basis(self, map_slug: str, basis: str) -> RevisionRecord | None:
        """Return the revision that accepts signatures of a basis: the live one or else the newest.

        `None` if there is none.

        Args:
            map_slug: The map.
            basis: The basis's digest or a prefix of at least 12 digits.

        Raises:
            MapNotFound: If there is no such map.
        """

        def read() -> RevisionRecord | None:
            return self._with_basis(map_slug, basis.lower())

        return self._database.kept.by_digest(("basis", map_slug), basis, read)

    def _with_basis(self, map_slug: str, prefix: str) -> RevisionRecord | None:
        with self._database.reading() as session:
            of_map = map_named(session, map_slug)
            if len(prefix) < FEWEST_DIGITS:
                return None
            of_basis = select(RevisionBasis.digest).where(
                RevisionBasis.map_id == of_map.id,
                RevisionBasis.basis.startswith(prefix, autoescape=True),
            )
            return session.scalar(
                select(RevisionRecord)
                .outerjoin(
                    LiveRevision,
                    (LiveRevision.map_id == RevisionRecord.map_id)
                    & (LiveRevision.digest == RevisionRecord.digest),
                )
                .where(RevisionRecord.map_id == of_map.id, RevisionRecord.digest.in_(of_basis))
                .order_by(
                    LiveRevision.digest.is_(None),
                    RevisionRecord.number.desc(),
                    RevisionRecord.digest.desc(),
                )
                .limit(1)
            )

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
            return _found(session, of_map, live.digest)

    def list(
        self, map_slug: str, after: str = "", limit: int = DEFAULT_LIMIT
    ) -> Page[RevisionRecord]:
        """Return the revisions that are older than the one of digest `after`.

        Raises:
            MapNotFound: If there is no such map.
            InvalidParameters: If `after` is no cursor of such a list.
        """
        with self._database.reading() as session:
            map_id = map_named(session, map_slug).id
            query = select(RevisionRecord).where(RevisionRecord.map_id == map_id)
            return page_by_age(session, query, RevisionRecord.digest, after, limit, numbered=True)

    def set_live(
        self, map_slug: str, digest: str, *, if_versions: Collection[int] | None = None
    ) -> MapRecord:
        """Make a revision the live one; a change counts up the map's version; return the map.

        Raises:
            MapNotFound: If there is no such map.
            MapChanged: If its version is none of `if_versions`.
            RevisionNotFound: If it has no such revision.
        """
        with self._database.writing() as session:
            of_map = locked_map(session, map_slug, if_versions)
            row = _found(session, of_map, digest)
            _make_live(session, of_map, row.digest)
            return map_record(session, of_map)

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
            session.delete(row)
            return row

    def size_bytes(self) -> int:
        """Return the total size of the revisions of all maps."""
        with self._database.reading() as session:
            return int(session.scalar(select(func.sum(RevisionRecord.size_bytes))) or 0)

    def files(self, map_id: str) -> dict[str, str]:
        """Return the digests of the revisions of a map, by the names of their files."""
        query = select(RevisionRecord.file_name, RevisionRecord.digest)
        with self._database.reading() as session:
            return dict(session.execute(query.where(RevisionRecord.map_id == map_id)).all())

    def files_by_map(self) -> dict[str, dict[str, str]]:
        """Return the same of each map that has revisions, by its id."""
        found: dict[str, dict[str, str]] = {}
        query = select(RevisionRecord.map_id, RevisionRecord.file_name, RevisionRecord.digest)
        with self._database.reading() as session:
            for map_id, file_name, digest in session.execute(query):
                found.setdefault(map_id, {})[file_name] = digest
        return found


def _make_live(session: Session, of_map: Map, digest: str) -> bool:
    """Make a revision the live one; return whether another one, or none, was."""
    live = session.get(LiveRevision, of_map.id)
    if live is None:
        session.add(LiveRevision(map_id=of_map.id, digest=digest))
    elif live.digest == digest:
        return False
    else:
        replaced = session.get_one(RevisionRecord, (of_map.id, live.digest))
        replaced.retained_from = datetime.now(UTC)
        live.digest = digest
    of_map.version += 1
    session.flush()
    return True


def _found(session: Session, of_map: Map, digest: str) -> RevisionRecord:
    prefix = digest.lower()
    query = select(RevisionRecord).where(
        RevisionRecord.map_id == of_map.id,
        RevisionRecord.digest.startswith(prefix, autoescape=True),
    )
    if len(prefix) < FEWEST_DIGITS:
        raise RevisionNotFound(
            f"map {of_map.slug!r} has no revision {digest!r}: a revision is named by its digest or"
            f" at least its {FEWEST_DIGITS} first digits"
        )
    rows = session.scalars(query.limit(2)).all()
    if not rows:
        raise RevisionNotFound(f"map {of_map.slug!r} has no revision {digest[:80]!r}")
    if len(rows) > 1:
        raise AmbiguousRevision(f"several revisions of {of_map.slug!r} begin with {digest!r}")
    return rows[0]
