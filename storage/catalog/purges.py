"""Purges: the removal for good of deleted maps and drives, a batch of rows at a time.

A purge begins with a mark on its entry in the recycle bin, from which commit on nobody finds or
restores what was deleted. Its rows follow in transactions of `ROWS` rows each, between which others
write; last, when its files are removed too, the row of the map or drive with the entry. Each
transaction finds what is left anew: after a crash any process goes on, and several may do so at the
same time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module

from sqlalchemy import ColumnElement, delete, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from storage.catalog.database import Repository
from storage.catalog.models import (
    Capture,
    CapturePart,
    Drive,
    ExpectedPose,
    JobRecord,
    LiveRevision,
    Map,
    PurgedMap,
    Recycled,
    RevisionBasis,
    RevisionRecord,
    Scan,
)

ROWS = 5_000
"""Rows that a transaction removes; decision 42 has how long other writers wait meanwhile."""

_ROWS_OF_FEW = 50
"""Deleting a drive or capture with few rows takes as long as 50 rows."""


@dataclass(frozen=True)
class Purge:
    """The purge of a map, or of a drive.

    Attributes:
        id: The id of the map or drive, which identified its entry in the recycle bin.
        map_id: The map itself, or that of the drive.
        drive_id: The drive, `None` for a map.
    """

    id: str
    map_id: str
    drive_id: str | None


class Purges(Repository):
    """The purges that have begun and not ended, the first one first."""

    def begun(self) -> Sequence[Purge]:
        """Return the purges of which something is left."""
        query = select(Recycled).where(Recycled.purging).order_by(Recycled.created_at, Recycled.id)
        with self._database.reading() as session:
            return [Purge(row.id, row.map_id, row.drive_id) for row in session.scalars(query)]

    def remove_some(self, purge: Purge, rows: int = ROWS) -> bool:
        """Remove rows of what is purged, all but that of the map or drive itself.

        Args:
            purge: The purge.
            rows: How many, about.

        Returns:
            Whether there may be more.
        """
        with self._database.writing(announced=False) as session:
            if not _locked(session, purge):
                return False
            batch = _Batch(session, rows)
            if purge.drive_id is not None:
                return not batch.takes_drive(purge.drive_id)
            return not batch.takes_map(purge.map_id)

    def end(self, purge: Purge) -> None:
        """Remove the row of a map or drive, when nothing else is left of it, with its entry."""
        with self._database.writing(announced=False) as session:
            if not _locked(session, purge):
                return
            if purge.drive_id is not None:
                session.execute(delete(Drive).where(Drive.id == purge.drive_id))
            else:
                _keep_version(session, purge.map_id)
                session.execute(delete(LiveRevision).where(LiveRevision.map_id == purge.map_id))
                session.execute(delete(Map).where(Map.id == purge.map_id))


def _keep_version(session: Session, map_id: str) -> None:
    """Keep the version of a map, for the next one of its name."""
    slug = session.get_one(Recycled, map_id).slug
    version = session.get_one(Map, map_id).version
    # That of the database in use: importing the other one takes a fiftieth of the service's start.
    dialect = import_module(f"sqlalchemy.dialects.{session.get_bind().dialect.name}")
    # In one statement: the purge of another map that had the name may end at the same time.
    row = dialect.insert(PurgedMap).values(slug=slug, version=version)
    session.execute(
        row.on_conflict_do_update(
            index_elements=[PurgedMap.slug],
            set_={"version": row.excluded.version},
            where=PurgedMap.version < row.excluded.version,
        )
    )


def _locked(session: Session, purge: Purge) -> bool:
    """Lock the entry of a purge, before any other row; return whether it has not ended."""
    entry = session.get(Recycled, purge.id, with_for_update=True)
    return entry is not None and entry.purging


class _Batch:
    """The rows that one transaction removes.

    Args:
        session: The transaction.
        rows: How many.
    """

    def __init__(self, session: Session, rows: int) -> None:
        self._session = session
        self._left = rows

    def takes_drive(self, drive_id: str) -> bool:
        """Remove the rows of a drive, but for its own. Return whether nothing is left."""
        # Lock the drive first, as compaction does; otherwise the two could deadlock.
        self._session.get(Drive, drive_id, with_for_update=True)
        return self._takes(Scan.drive_id == drive_id, Scan.index) and self._takes(
            ExpectedPose.drive_id == drive_id, ExpectedPose.index
        )

    def takes_map(self, map_id: str) -> bool:
        """Remove the rows of a map, but for its own. Return whether nothing is left."""
        if not self._takes_drives(map_id):
            return False
        self._session.execute(delete(LiveRevision).where(LiveRevision.map_id == map_id))
        return (
            self._takes(RevisionBasis.map_id == map_id, RevisionBasis.basis)
            and self._takes(RevisionRecord.map_id == map_id, RevisionRecord.digest)
            and self._takes_captures(map_id)
            and self._takes(JobRecord.map_id == map_id, JobRecord.id)
        )

    def _takes_drives(self, map_id: str) -> bool:
        # By slug, in whose index they are.
        first = select(Drive.id).where(Drive.map_id == map_id).order_by(Drive.slug).limit(1)
        while (drive_id := self._session.scalar(first)) is not None:
            # The purge of that drive alone locks its entry first, too.
            self._session.get(Recycled, drive_id, with_for_update=True)
            if not self.takes_drive(drive_id):
                return False
            self._session.execute(delete(Drive).where(Drive.id == drive_id))
            self._left -= _ROWS_OF_FEW
        return True

    def _takes_captures(self, map_id: str) -> bool:
        first = select(Capture.id).where(Capture.map_id == map_id).limit(1)
        while (capture_id := self._session.scalar(first)) is not None:
            if not self._takes(CapturePart.capture_id == capture_id, CapturePart.number):
                return False
            self._session.execute(delete(Capture).where(Capture.id == capture_id))
            self._left -= _ROWS_OF_FEW
        return True

    def _takes(self, condition: ColumnElement[bool], order: InstrumentedAttribute[object]) -> bool:
        """Remove rows in the order of a column. Return whether nothing is left.

        A range of them, which both databases find in the index: not so a list, or a subquery.
        """
        if self._left <= 0:
            return False
        in_order = select(order).where(condition).order_by(order)
        last = self._session.scalar(in_order.offset(self._left - 1).limit(1))
        removed = delete(order.class_).where(condition)
        if last is not None:
            removed = removed.where(order <= last)
        self._left -= self._session.connection().execute(removed).rowcount
        return last is None
