"""The recycle bin: deleted maps and drives, until they are restored or removed for good.

Their rows and files stay, and nothing finds them by name: their slug is made of their id, and no
client can choose such a slug. So the name is free, and what is deleted answers as if it were gone.
"""

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from sqlalchemy import BigInteger, Select, case, cast, func, or_, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from storage.catalog.batches import batches
from storage.catalog.database import Repository
from storage.catalog.drives import drive_named
from storage.catalog.jobs import cancel_job
from storage.catalog.maps import last_version, locked_map, map_of_id
from storage.catalog.models import (
    OPEN_STATES,
    Capture,
    CapturePart,
    Drive,
    JobRecord,
    Map,
    Recycled,
    RevisionRecord,
    Scan,
)
from storage.catalog.pages import DEFAULT_LIMIT, page_by_age
from storage.catalog.records import Page
from storage.errors import DriveExists, MapExists, MapNotFound, NotInRecycleBin
from storage.files.drive_chunks import BYTES_PER_RETURN
from storage.names import RECYCLED, checked_slug, is_recycled, recycled_slug

_UNDER_ANOTHER_NAME = (
    "restore the deleted one under another name, with `?name=` of the request or `--name` of the"
    " command"
)


@dataclass(frozen=True)
class RecycledRecord:
    """A deleted map or drive.

    Attributes:
        id: The map's or drive's id, which identifies the entry.
        map_id: Id of the map, or of the map that has the drive.
        map_slug: The name of its map; of a deleted map, the name that it had.
        drive_slug: The name that the drive had, `None` for a map.
        deleted_at: When it was deleted.
        size_bytes: What its returns, and a map's revisions and parts of captures, take on disk.
    """

    id: str
    map_id: str
    map_slug: str
    drive_slug: str | None
    deleted_at: datetime
    size_bytes: int

    def __str__(self) -> str:
        """Return a description for users."""
        of_map = f"map {self.map_slug}"
        return of_map if self.drive_slug is None else f"drive {self.drive_slug} of {of_map}"


class RecycleBin(Repository):
    """Deleted maps and drives, the last one first; drives of a deleted map are part of that."""

    def put_map(
        self, slug: str, *, if_versions: Collection[int] | None = None, purging: bool = False
    ) -> RecycledRecord:
        """Delete a map with all that belongs to it, and cancel its queued and running jobs.

        Args:
            slug: The map.
            if_versions: Delete it only if its version is one of these.
            purging: Begin to remove it for good; the size of the answer is 0 then.

        Raises:
            MapNotFound: If there is none of that slug.
            MapChanged: If its version is none of `if_versions`.
        """
        with self._database.writing() as session:
            row = locked_map(session, slug, if_versions)
            of_map = JobRecord.map_id == row.id, JobRecord.state.in_(OPEN_STATES)
            for job_id in session.scalars(select(JobRecord.id).where(*of_map)).all():
                cancel_job(session, job_id)
            entry = _put(session, row, row.id, purging=purging)
        return entry if purging else self._with_size(entry)

    def put_drive(self, map_slug: str, slug: str, *, purging: bool = False) -> RecycledRecord:
        """Delete a drive; revisions that were built from it stay.

        Args:
            map_slug: The map.
            slug: The drive.
            purging: Begin to remove it for good; the size of the answer is 0 then.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
        """
        with self._database.writing() as session:
            row = drive_named(session, map_slug, slug, lock=True)
            entry = _put(session, row, row.map_id, row.id, purging=purging)
        return entry if purging else self._with_size(entry)

    def get(self, entry_id: str) -> RecycledRecord:
        """Return an entry.

        Raises:
            NotInRecycleBin: If it is not there, or no longer.
        """
        with self._database.reading() as session:
            return _recycled(session, [_found(session, entry_id)])[0]

    def list(
        self, after: str = "", limit: int = DEFAULT_LIMIT, *, slugs: Collection[str] | None = None
    ) -> Page[RecycledRecord]:
        """Return the entries that were deleted before the entry `after`.

        Args:
            after: Cursor of an entry, empty for the first page.
            limit: Number of entries.
            slugs: Only entries of maps of these names.

        Raises:
            InvalidParameters: If `after` is no cursor of such a list.
        """
        with self._database.reading() as session:
            query = _visible()
            if slugs is not None:
                is_map = Recycled.drive_id.is_(None)
                of_map = is_map & Recycled.slug.in_(slugs)
                query = query.where(of_map | Map.slug.in_(slugs))
            page = page_by_age(session, query, Recycled.id, after, limit)
            return Page(tuple(_recycled(session, page.items)), page.next_after)

    def expired(self, before: datetime) -> Sequence[RecycledRecord]:
        """Return the entries that were deleted until a time, the first one first."""
        is_expired = Recycled.created_at <= before
        query = _visible().where(is_expired).order_by(Recycled.created_at, Recycled.id)
        with self._database.reading() as session:
            found = session.scalars(query).all()
            return [record for some in batches(found) for record in _recycled(session, some)]

    def restore(self, entry_id: str, slug: str | None = None) -> RecycledRecord:
        """Take a map or drive out of the bin as it was, under its name or another one.

        Drives that were deleted before their map are in the bin from now on: until when they could
        be restored may have passed while nobody could.

        Raises:
            NotInRecycleBin: If it is not there, or no longer.
            InvalidSlug: If the other name is no slug.
            MapExists: If a map has that name now.
            DriveExists: If a drive of the map has that name now.
        """
        with _named_taken(self, entry_id, slug), self._database.writing() as session:
            entry = _found(session, entry_id, lock=True)
            entry.slug = entry.slug if slug is None else checked_slug(slug)
            restored = _recycled(session, [entry], {})[0]
            if entry.drive_id is None:
                of_map = session.get_one(Map, entry.map_id, with_for_update=True)
                of_map.slug = entry.slug
                of_map.version = max(of_map.version, last_version(session, entry.slug)) + 1
                of_drives = Recycled.map_id == of_map.id, Recycled.drive_id.is_not(None)
                session.execute(
                    update(Recycled).where(*of_drives).values(created_at=datetime.now(UTC))
                )
            else:
                session.get_one(Drive, entry.drive_id, with_for_update=True).slug = entry.slug
            session.delete(entry)
        return self._with_size(restored)

    def begin_purge(self, entry_id: str, *, before: datetime | None = None) -> RecycledRecord:
        """Take an entry out of the bin, to remove it for good; return what it was.

        `Purges` removes its rows: from now on nobody finds it.

        Args:
            entry_id: The entry.
            before: Only if it was deleted until then.

        Raises:
            NotInRecycleBin: If it is not there, or no longer, or was deleted later.
        """
        found = self.get(entry_id)
        with self._database.writing() as session:
            entry = _found(session, entry_id, lock=True)
            if before is not None and entry.created_at > before:
                raise _missing(entry_id)
            entry.purging = True
            return _recycled(session, [entry], {entry_id: found.size_bytes})[0]

    def _with_size(self, entry: RecycledRecord) -> RecycledRecord:
        """Return an entry with its size, which is read outside of the change: it reads all scans.

        It is 0 if the entry was removed for good since.
        """
        of_map, of_drive = ([entry.id], []) if entry.drive_slug is None else ([], [entry.id])
        with self._database.reading() as session:
            return replace(entry, size_bytes=_sizes(session, of_map, of_drive).get(entry.id, 0))


def _put(
    session: Session, row: Map | Drive, map_id: str, drive_id: str | None = None, *, purging: bool
) -> RecycledRecord:
    entry = Recycled(
        id=row.id,
        map_id=map_id,
        drive_id=drive_id,
        slug=row.slug,
        created_at=datetime.now(UTC),
        purging=purging,
    )
    session.add(entry)
    session.flush()
    row.slug = recycled_slug(row.id)
    session.flush()
    return _recycled(session, [entry], {})[0]


def _visible() -> Select[Recycled]:
    """Return the query of entries: not drives whose map is deleted too, nor what is purged."""
    is_map = Recycled.drive_id.is_(None)
    joined = select(Recycled).join(Map, Map.id == Recycled.map_id)
    return joined.where(~Recycled.purging, or_(is_map, Map.slug < RECYCLED))


def _found(session: Session, entry_id: str, *, lock: bool = False) -> Recycled:
    entry = session.get(Recycled, entry_id, with_for_update=lock)
    if entry is None or entry.purging:
        raise _missing(entry_id)
    if entry.drive_id is not None:
        try:
            map_of_id(session, entry.map_id)
        except MapNotFound as error:
            raise _missing(entry_id) from error
    return entry


def _missing(entry_id: str) -> NotInRecycleBin:
    return NotInRecycleBin(f"the recycle bin has no map or drive with id {entry_id[:80]!r}")


@contextmanager
def _named_taken(recycle_bin: RecycleBin, entry_id: str, slug: str | None) -> Iterator[None]:
    """Raise `MapExists` or `DriveExists` if the name is taken."""
    try:
        yield
    except IntegrityError as error:
        entry = recycle_bin.get(entry_id)
        if entry.drive_slug is None:
            name = slug or entry.map_slug
            raise MapExists(f"there is a map {name!r} already: {_UNDER_ANOTHER_NAME}") from error
        raise DriveExists(
            f"map {entry.map_slug!r} has a drive {slug or entry.drive_slug!r} already:"
            f" {_UNDER_ANOTHER_NAME}"
        ) from error


def _sizes(session: Session, maps: Sequence[str], drives: Sequence[str]) -> Mapping[str, int]:
    """Return what maps and drives take on disk, by their ids."""
    sizes: dict[str, int] = defaultdict(int)
    returns = (
        select(Drive.map_id, Drive.id, func.sum(Scan.returns))
        .join(Scan, Scan.drive_id == Drive.id)
        .where(Scan.chunk != "", or_(Drive.map_id.in_(maps), Drive.id.in_(drives)))
        .group_by(Drive.map_id, Drive.id)
    )
    for map_id, drive_id, count in session.execute(returns):
        for name in (map_id, drive_id):
            sizes[name] += int(count) * BYTES_PER_RETURN
    revisions = (
        select(RevisionRecord.map_id, func.sum(RevisionRecord.size_bytes))
        .where(RevisionRecord.map_id.in_(maps))
        .group_by(RevisionRecord.map_id)
    )
    part_bytes = Capture.part_bytes
    rest_bytes = Capture.size_bytes - cast(CapturePart.number, BigInteger) * part_bytes
    parts = (
        select(
            Capture.map_id,
            func.sum(case((rest_bytes < part_bytes, rest_bytes), else_=part_bytes)),
        )
        .join(CapturePart, CapturePart.capture_id == Capture.id)
        .where(Capture.map_id.in_(maps))
        .group_by(Capture.map_id)
    )
    for map_id, size_bytes in (*session.execute(revisions), *session.execute(parts)):
        sizes[map_id] += int(size_bytes)
    return sizes


def _recycled(
    session: Session, entries: Sequence[Recycled], sizes: Mapping[str, int] | None = None
) -> list[RecycledRecord]:
    """Return the records of entries, with sizes by their ids, or with those that they have now."""
    if sizes is None:
        maps = [entry.id for entry in entries if entry.drive_id is None]
        drives = [entry.id for entry in entries if entry.drive_id is not None]
        sizes = _sizes(session, maps, drives)
    of_maps = select(Map.id, Map.slug).where(Map.id.in_({entry.map_id for entry in entries}))
    slugs = dict(session.execute(of_maps).all())
    deleted = select(Recycled.id, Recycled.slug).where(Recycled.id.in_(slugs))
    slugs |= {row.id: row.slug for row in session.execute(deleted) if is_recycled(slugs[row.id])}
    return [
        RecycledRecord(
            entry.id,
            entry.map_id,
            slugs[entry.map_id],
            None if entry.drive_id is None else entry.slug,
            entry.created_at,
            sizes.get(entry.id, 0),
        )
        for entry in entries
    ]
