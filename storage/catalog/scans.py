"""Scans in the catalog: their chunk files, and the facts about them."""

import math
from collections.abc import Collection, Sequence
from operator import itemgetter

from sqlalchemy import bindparam, func, insert, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from core.numbers import nan_if_none
from core.scans.pose import Pose
from storage.catalog.batches import batches
from storage.catalog.computed_poses import forget_computed
from storage.catalog.database import Repository
from storage.catalog.expected_poses import with_expected
from storage.catalog.maps import no_map
from storage.catalog.models import Base, Drive, Map, Scan
from storage.catalog.put_target import PutTarget, hold
from storage.catalog.records import ScanRecord
from storage.catalog.scan_poses import at_indices
from storage.errors import LostRace, ScanNotFound
from storage.files.drive_chunks import BYTES_PER_RETURN
from storage.names import checked_slug, is_recycled, new_id

# Of every upload; made once, because making a statement takes longer than SQLite takes for it.
_DRIVE_TO_PUT_INTO = (
    select(Map.id, Drive.id, Drive.closed)
    .outerjoin(Drive, (Drive.map_id == Map.id) & (Drive.slug == bindparam("drive_slug")))
    .where(Map.slug == bindparam("map_slug"))
)
_FACTS = (  # as `_record` takes them
    Scan.index,
    Scan.chunk,
    Scan.row,
    Scan.digest,
    Scan.returns,
    Scan.dropped_returns,
    Scan.timestamp_s,
    Scan.pose,
)
_ONE_SCAN = select(*_FACTS).where(
    Scan.drive_id == bindparam("drive_id"), Scan.index == bindparam("scan_index")
)
_NEW_SCAN = insert(Base.metadata.tables["scans"])


class Scans(Repository):
    """The scans of each drive, in the order of their indices."""

    def target(self, map_slug: str, drive_slug: str, indices: Collection[int]) -> PutTarget:
        """Return the drive that scans of these indices are put into.

        Raises:
            MapNotFound: If there is no such map.
            InvalidSlug: If the drive's name is no slug.
        """
        with self._database.reading() as session:
            named = {"map_slug": map_slug, "drive_slug": drive_slug}
            found = session.connection().execute(_DRIVE_TO_PUT_INTO, named).first()
            if found is None or is_recycled(map_slug):
                raise no_map(map_slug)
            checked_slug(drive_slug)
            map_id, drive_id, closed = found
            if drive_id is None:
                return PutTarget(
                    map_id, new_id(), drive_slug, exists=False, closed=False, stored={}
                )
            stored = _among(session, drive_id, indices)
            return PutTarget(
                map_id, drive_id, drive_slug, exists=True, closed=closed, stored=stored
            )

    def add(self, target: PutTarget, records: Sequence[ScanRecord]) -> list[ScanRecord]:
        """Add scans whose chunk file is on disk, and their drive if it is new: all or nothing.

        A scan without a pose or time gets the one that was put before it.

        Returns:
            What is stored.

        Raises:
            LostRace: If the target has changed: the drive was made, closed or removed, the map was
                removed, or one of the scans was added.
        """
        try:
            with self._database.writing(announced=False) as session:
                hold(session, target)
                records = with_expected(session, target.drive_id, records)
                if any(record.pose is not None for record in records):
                    forget_computed(session, session.get_one(Drive, target.drive_id))
                rows = [_values(target.drive_id, one) for one in records]
                session.connection().execute(_NEW_SCAN, rows)
                return list(records)
        except IntegrityError as error:  # one of the scans was added, or the drive
            raise LostRace(f"drive {target.drive_slug!r} changed meanwhile") from error

    def get(self, drive_id: str, index: int) -> ScanRecord:
        """Return one scan's facts.

        Raises:
            ScanNotFound: If the drive has no such scan, or is gone.
        """
        with self._database.reading() as session:
            found = _among(session, drive_id, [index])
            if not found:
                raise ScanNotFound(f"there is no scan {index}")
            return found[index]

    def of_drive(self, drive_id: str) -> list[ScanRecord]:
        """Return the facts of all scans of a drive."""
        query = select(*_FACTS).where(Scan.drive_id == drive_id).order_by(Scan.index)
        with self._database.reading() as session:
            return [_record(*row) for row in session.execute(query)]

    def digests(self, drive_id: str) -> list[str]:
        """Return the digests of all scans of a drive, in the order of their indices."""
        query = select(Scan.digest).where(Scan.drive_id == drive_id).order_by(Scan.index)
        with self._database.reading() as session:
            return list(session.scalars(query))

    def of_chunk(self, drive_id: str, chunk: str) -> list[ScanRecord]:
        """Return the facts of the scans of a drive that are in a chunk file."""
        query = select(*_FACTS).where(Scan.drive_id == drive_id, Scan.chunk == chunk)
        with self._database.reading() as session:
            # Sorted here: SQLite would go through all scans of the drive in order of their indices.
            return [_record(*row) for row in sorted(session.execute(query), key=itemgetter(0))]

    def move(self, drive_id: str, scans: Sequence[ScanRecord], chunk: str) -> set[str]:
        """Set the chunk file of scans, whose rows are in the given order.

        Returns:
            The chunk files that no longer hold a scan.

        Raises:
            LostRace: If one of the scans is no longer where it was.
        """
        old = {scan.chunk for scan in scans}
        with self._database.writing(announced=False) as session:
            if session.get(Drive, drive_id, with_for_update=True) is None:
                raise LostRace("the drive was removed meanwhile")
            stored = _among(session, drive_id, {scan.index for scan in scans})
            for scan in scans:
                now = stored.get(scan.index)
                if now is None or (now.chunk, now.row) != (scan.chunk, scan.row):
                    raise LostRace(f"scan {scan.index} was moved or removed meanwhile")
            session.execute(
                update(Scan),
                [
                    {"drive_id": drive_id, "index": scan.index, "chunk": chunk, "row": row}
                    for row, scan in enumerate(scans)
                ],
            )
            return old - _holding(session, drive_id, sorted(old))

    def size_bytes(self) -> int:
        """Return the total size of the stored returns of all drives."""
        with self._database.reading() as session:
            kept = select(func.sum(Scan.returns)).where(Scan.chunk != "")
            return int(session.scalar(kept) or 0) * BYTES_PER_RETURN

    def lacks_returns(self, drive_id: str) -> bool:
        """Return whether the returns of a scan of a drive were dropped after a build."""
        dropped = (Scan.drive_id == drive_id) & (Scan.chunk == "")
        with self._database.reading() as session:
            return session.scalar(select(Scan.index).where(dropped).limit(1)) is not None

    def lacking_returns(self) -> set[str]:
        """Return the ids of the drives with a scan whose returns were dropped after a build."""
        with self._database.reading() as session:
            return set(session.scalars(select(Scan.drive_id).where(Scan.chunk == "").distinct()))

    def chunks_by_drive(self) -> dict[str, set[str]]:
        """Return the names of the chunk files of each drive that has returns, by its id."""
        found: dict[str, set[str]] = {}
        query = select(Scan.drive_id, Scan.chunk).where(Scan.chunk != "").distinct()
        with self._database.reading() as session:
            for drive_id, chunk in session.execute(query):
                found.setdefault(drive_id, set()).add(chunk)
        return found


def _among(session: Session, drive_id: str, indices: Collection[int]) -> dict[int, ScanRecord]:
    """Return those of the scans of these indices that are stored."""
    if len(indices) == 1:
        one = {"drive_id": drive_id, "scan_index": next(iter(indices))}
        row = session.connection().execute(_ONE_SCAN, one).first()
        return {} if row is None else {row[0]: _record(*row)}
    requested = set(indices)
    found: dict[int, ScanRecord] = {}
    for clause in at_indices(Scan.index, sorted(requested)):
        rows = session.execute(select(*_FACTS).where(Scan.drive_id == drive_id, clause))
        found.update((row[0], _record(*row)) for row in rows if row[0] in requested)
    return found


def _holding(session: Session, drive_id: str, chunks: Sequence[str]) -> set[str]:
    """Return those of some chunk files that hold a scan of a drive; it may have many others."""
    found: set[str] = set()
    for some in batches(chunks):
        query = select(Scan.chunk).where(Scan.drive_id == drive_id, Scan.chunk.in_(some))
        found.update(session.scalars(query.distinct()))
    return found


def chunks_of(session: Session, drive_id: str) -> set[str]:
    """Return the names of the chunk files that hold the scans of a drive."""
    kept = (Scan.drive_id == drive_id) & (Scan.chunk != "")
    return set(session.scalars(select(Scan.chunk).where(kept).distinct()))


def _values(drive_id: str, record: ScanRecord) -> dict[str, object]:
    """Return a new row, by the names of its columns."""
    return {
        "drive_id": drive_id,
        "scan_index": record.index,
        "chunk": record.chunk,
        "chunk_row": record.row,
        "digest": record.digest,
        "returns": record.returns,
        "dropped_returns": record.dropped_returns,
        "timestamp_s": record.timestamp_s if math.isfinite(record.timestamp_s) else None,
        "pose": None if record.pose is None else list(record.pose.as_tuple()),
    }


def _record(
    index: int,
    chunk: str,
    row: int,
    digest: str,
    returns: int,
    dropped_returns: int,
    timestamp_s: float | None,
    pose: Sequence[float] | None,
) -> ScanRecord:
    return ScanRecord(
        index,
        chunk,
        row,
        digest,
        returns,
        dropped_returns,
        nan_if_none(timestamp_s),
        None if pose is None else Pose(*pose),
    )
