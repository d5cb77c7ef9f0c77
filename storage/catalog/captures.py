"""Captures that are uploaded in parts, in the catalog: until they are read or expire."""

from collections.abc import Collection, Sequence
from datetime import UTC, datetime

from sqlalchemy import bindparam, delete, func, or_, select
from sqlalchemy.orm import Session

from storage.catalog.capture_records import capture_record, capture_summaries
from storage.catalog.database import Repository
from storage.catalog.ended_captures import clear_expired, clear_read
from storage.catalog.job_queue import queue_job
from storage.catalog.jobs import cancel_job
from storage.catalog.key_lock import lock_key
from storage.catalog.maps import map_named
from storage.catalog.models import (
    CAPTURE,
    Capture,
    CapturePart,
    JobRecord,
    JobState,
    Map,
)
from storage.catalog.pages import DEFAULT_LIMIT, page_by_age
from storage.catalog.records import CaptureRecord, CaptureSummary, NewCapture, Page
from storage.catalog.same_capture import same_capture
from storage.errors import (
    CaptureNotFound,
    CaptureQueued,
    PartConflict,
    PartsMissing,
    TooManyCaptures,
)
from storage.index_ranges import ranges_text
from storage.names import RECYCLED, checked_slug, new_id

_LOST_PART = delete(CapturePart).where(
    CapturePart.capture_id == bindparam("of_capture"),
    CapturePart.number == bindparam("at_number"),
    CapturePart.file_name == bindparam("in_file"),
)


class Captures(Repository):
    """The captures of each map, newest first."""

    def create(
        self, map_slug: str, new: NewCapture, most_bytes: int | None = None
    ) -> tuple[CaptureRecord, bool]:
        """Begin a capture; return it, and whether it is new.

        One of the same drive, files and digest is returned: an upload is resumed without its id.
        While it takes parts it gets the new topic, after that only one of this topic is returned.
        One that was read is only while the drive that got its scans is there.

        Args:
            map_slug: The map.
            new: What is announced of it.
            most_bytes: Maximum size of the key's captures that are not read yet, together.

        Raises:
            MapNotFound: If there is no such map.
            InvalidSlug: If the drive's name is not a valid slug.
            TooManyCaptures: If the key's limit of bytes of captures is reached.
        """
        checked_slug(new.drive)
        now = datetime.now(UTC)
        row = Capture(
            id=new_id(),
            map_id="",
            drive=new.drive,
            files=[list(file) for file in new.files],
            size_bytes=new.size_bytes,
            part_bytes=new.part_bytes,
            topic=new.topic,
            first_scan=new.first_scan,
            digest=new.digest,
            key_id=new.key_id,
            created_at=now,
            touched_at=now,
        )
        with self._database.writing(announced=False) as session:
            lock_key(session, "captures", None)  # of all keys: another one may begin the same
            row.map_id = map_named(session, map_slug, shared=True).id
            found = same_capture(session, row.map_id, new, lock=True)
            if found is not None:
                found.topic = new.topic or found.topic
                return capture_record(session, found), False
            if most_bytes is not None:
                _require_room(session, row, most_bytes)
            session.add(row)
            session.flush()
            return capture_record(session, row), True

    def has_same(self, map_slug: str, new: NewCapture) -> bool:
        """Return whether `create` would return a capture that is there, and not make one.

        Raises:
            MapNotFound: If there is no such map.
        """
        with self._database.reading() as session:
            return same_capture(session, map_named(session, map_slug).id, new) is not None

    def get(self, map_slug: str, drive: str, capture_id: str) -> CaptureRecord:
        """Return a capture.

        Raises:
            MapNotFound: If there is no such map.
            CaptureNotFound: If the drive has no such capture.
        """
        with self._database.reading() as session:
            return capture_record(session, _found(session, map_slug, drive, capture_id))

    def list(
        self,
        map_slug: str,
        drive: str | None = None,
        after: str = "",
        limit: int = DEFAULT_LIMIT,
    ) -> Page[CaptureSummary]:
        """Return the captures of a map, or of one drive, that are older than `after`.

        Raises:
            MapNotFound: If there is no such map.
            InvalidSlug: If the drive's name is not a valid slug.
            InvalidParameters: If `after` is no cursor of such a list.
        """
        with self._database.reading() as session:
            of_map = map_named(session, map_slug)
            query = select(Capture).where(Capture.map_id == of_map.id)
            if drive is not None:
                query = query.where(Capture.drive == checked_slug(drive))
            page = page_by_age(session, query, Capture.id, after, limit)
            return Page(tuple(capture_summaries(session, page.items)), page.next_after)

    def of_job(self, capture_id: str) -> CaptureRecord:
        """Return the capture of that id, whatever its map is called now.

        Raises:
            CaptureNotFound: If it is gone.
        """
        with self._database.reading() as session:
            row = session.get(Capture, capture_id)
            if row is None:
                raise CaptureNotFound(f"the capture with id {capture_id[:80]!r} is gone")
            return capture_record(session, row)

    def parts(self, capture_id: str) -> dict[int, tuple[str, str]]:
        """Return the digest and file of each stored part, by its number."""
        with self._database.reading() as session:
            rows = session.scalars(
                select(CapturePart)
                .where(CapturePart.capture_id == capture_id)
                .order_by(CapturePart.number)
            )
            return {row.number: (row.digest, row.file_name) for row in rows}

    def part(
        self, map_slug: str, drive: str, capture_id: str, number: int
    ) -> tuple[CaptureSummary, tuple[str, str] | None]:
        """Return a capture, and digest and file of one of its parts, `None` if it is not stored.

        Raises:
            MapNotFound: If there is no such map.
            CaptureNotFound: If the drive has no such capture.
        """
        with self._database.reading() as session:
            row = _found(session, map_slug, drive, capture_id)
            part = session.get(CapturePart, (row.id, number))
            stored = None if part is None else (part.digest, part.file_name)
            return capture_summaries(session, [row])[0], stored

    def add_part(
        self, map_slug: str, drive: str, capture_id: str, number: int, digest: str, file_name: str
    ) -> tuple[CaptureRecord, str]:
        """Add a part that is stored; return its capture, and the file that holds it now.

        That is another one if another writer was faster; then nothing is changed.

        Raises:
            MapNotFound: If there is no such map.
            CaptureNotFound: If the drive has no such capture.
            CaptureQueued: If it takes no more parts.
            PartConflict: If other bytes are stored as this part.
        """
        with self._database.writing(announced=False) as session:
            row = _found(session, map_slug, drive, capture_id, lock=True)
            require_open(capture_summaries(session, [row])[0])
            part = session.get(CapturePart, (row.id, number))
            if part is not None:
                require_same_part(row.id, number, part.digest, digest)
            else:
                part = CapturePart(row.id, number, digest, file_name)
                session.add(part)
                row.touched_at = datetime.now(UTC)
                session.flush()
            return capture_record(session, row), part.file_name

    def forget_parts(self, lost: Collection[tuple[str, int, str]]) -> None:
        """Remove parts whose files are lost, all at once: they can be sent again.

        One that was sent again meanwhile has another file, and stays.

        Args:
            lost: Capture, number and file of each.
        """
        if not lost:
            return
        names = ("of_capture", "at_number", "in_file")
        with self._database.writing(announced=False) as session:
            parts = [dict(zip(names, part, strict=True)) for part in lost]
            session.connection().execute(_LOST_PART, parts)

    def complete(
        self,
        map_slug: str,
        drive: str,
        capture_id: str,
        *,
        topic: str | None = None,
        key_id: str | None = None,
        most_queued: int | None = None,
    ) -> CaptureRecord:
        """Queue the job that reads a complete capture; one that is queued or read stays as it is.

        Args:
            map_slug: The map.
            drive: The drive.
            capture_id: The capture.
            topic: The topic of the scans from now on, `None` to leave it.
            key_id: Id of the key that requests it.
            most_queued: Maximum number of queued jobs of that key.

        Raises:
            MapNotFound: If there is no such map.
            CaptureNotFound: If the drive has no such capture.
            CaptureQueued: If the job that reads it is being cancelled.
            PartsMissing: If parts are missing.
            TooManyBuilds: If the key's limit of queued jobs is reached.
        """
        with self._database.writing(announced=False) as session:
            row = _found(session, map_slug, drive, capture_id, lock=True)
            capture = capture_record(session, row)
            if not capture.takes_parts:
                _require_not_cancelled(capture)
                return capture
            if capture.missing:
                raise PartsMissing(
                    f"capture {row.id} has {capture.parts} parts, missing are"
                    f" {ranges_text(capture.missing)}"
                )
            now = datetime.now(UTC)
            if topic is not None:
                row.topic = topic
            job = JobRecord(
                id=new_id(),
                map_id=row.map_id,
                parameters={"capture": row.id, "drive": row.drive},
                kind=CAPTURE,
                key_id=key_id,
                created_at=now,
            )
            queue_job(session, job, most_queued)
            row.job_id, row.touched_at = job.id, now
            session.flush()
            return capture_record(session, row)

    def delete(self, map_slug: str, drive: str, capture_id: str) -> CaptureSummary:
        """Remove a capture and cancel its job; return its record. Stored scans stay.

        Raises:
            MapNotFound: If there is no such map.
            CaptureNotFound: If the drive has no such capture.
        """
        with self._database.writing(announced=False) as session:
            row = _found(session, map_slug, drive, capture_id, lock=True)
            capture = capture_summaries(session, [row])[0]
            if row.job_id is not None:
                cancel_job(session, row.job_id)
            session.execute(delete(Capture).where(Capture.id == row.id))
            return capture

    def clear(self, before: datetime | None) -> Sequence[tuple[str, str]]:
        """Remove parts of captures that were read, and captures that expired: some of them.

        Each that expired before it was read is in the audit log. Call it until nothing is left.

        Args:
            before: Captures expire that were touched last, and whose job ended, before this; none
                does with `None`.

        Returns:
            Map and id of each capture whose files are no longer named; none if nothing is left.
        """
        with self._database.writing(announced=False) as session:
            found = {
                *clear_read(session),
                *(() if before is None else clear_expired(session, before)),
            }
            return sorted(found)

    def named_files(self) -> dict[str, dict[str, dict[str, int]]]:
        """Return the files of captures and their parts' numbers, by map id and the capture's."""
        found: dict[str, dict[str, dict[str, int]]] = {}
        with self._database.reading() as session:
            query = select(
                Capture.map_id, Capture.id, CapturePart.number, CapturePart.file_name
            ).outerjoin(CapturePart, CapturePart.capture_id == Capture.id)
            for map_id, capture_id, number, file_name in session.execute(query):
                files = found.setdefault(map_id, {}).setdefault(capture_id, {})
                if file_name is not None:
                    files[file_name] = number
        return found


def _found(
    session: Session, map_slug: str, drive: str, capture_id: str, *, lock: bool = False
) -> Capture:
    of_map = map_named(session, map_slug, shared=lock)
    row = session.get(Capture, capture_id, with_for_update=lock)
    if row is None or (row.map_id, row.drive) != (of_map.id, drive):
        raise CaptureNotFound(
            f"drive {drive[:80]!r} of map {map_slug!r} has no capture {capture_id[:80]!r}"
        )
    return row


def require_open(capture: CaptureSummary) -> None:
    """Raise `CaptureQueued` if a capture takes no more parts."""
    if not capture.takes_parts:
        raise CaptureQueued(f"capture {capture.id} is {capture.state}, it takes no more parts")


def _require_not_cancelled(capture: CaptureSummary) -> None:
    """Raise `CaptureQueued` if the running job of a capture is to stop: it will not be read."""
    job = capture.job
    if job is not None and job.state == JobState.RUNNING and job.cancel_requested:
        raise CaptureQueued(
            f"the reading of capture {capture.id} is being cancelled: complete it when job"
            f" {job.id} has ended"
        )


def require_same_part(capture_id: str, number: int, stored: str, digest: str) -> None:
    """Raise `PartConflict` if a part that is put has another digest than the one stored."""
    if stored != digest:
        raise PartConflict(
            f"part {number} of capture {capture_id} is stored with digest {stored}, the one put"
            f" has {digest}: delete the capture to begin anew"
        )


def _require_room(session: Session, new: Capture, most_bytes: int) -> None:
    held = int(
        session.scalar(
            select(func.sum(Capture.size_bytes))
            .join(Map, Map.id == Capture.map_id)
            .outerjoin(JobRecord, Capture.job_id == JobRecord.id)
            .where(
                Capture.key_id == new.key_id,
                Map.slug < RECYCLED,  # of a deleted map none can be deleted
                or_(JobRecord.id.is_(None), JobRecord.state != JobState.DONE),
            )
        )
        or 0
    )
    if held + new.size_bytes > most_bytes:
        raise TooManyCaptures(
            f"key {new.key_id} has {held} bytes of captures that are not read yet; with this one of"
            f" {new.size_bytes} it would exceed the limit of {most_bytes}: wait until one is read,"
            " or delete one"
        )
