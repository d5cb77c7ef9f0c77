"""Drives in the catalog."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import ColumnElement, Select, and_, case, func, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import InstrumentedAttribute, Session

from core.scans.accumulation import require_count
from core.scans.mounting import Mounting
from storage.catalog import audit_chain
from storage.catalog.batches import batches
from storage.catalog.database import Repository
from storage.catalog.maps import map_named, map_of_id
from storage.catalog.models import PURGED, Drive, ExpectedPose, Map, Recycled, Scan
from storage.catalog.pages import DEFAULT_LIMIT, ROWS_AT_ONCE, one_more, page_of
from storage.catalog.records import CountedDrive, DriveRecord, FilledDrive, Page
from storage.errors import DriveNotFound, ReturnsGone
from storage.index_ranges import IndexRange
from storage.names import RECYCLED, checked_slug, is_recycled, new_id


class Drives(Repository):
    """The drives of each map, in the order of their slugs."""

    def get(self, map_slug: str, slug: str) -> CountedDrive:
        """Return a drive with all counts, which reads the facts of all its scans.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
        """
        with self._database.reading() as session:
            return next(_counted(session, [drive_named(session, map_slug, slug)]))

    def find(self, map_slug: str, slug: str) -> DriveRecord:
        """Return a drive without any counts, which take long where it has many scans.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
        """
        with self._database.reading() as session:
            return DriveRecord(**_fields(drive_named(session, map_slug, slug)))

    def list(
        self, map_slug: str, after: str = "", limit: int = DEFAULT_LIMIT
    ) -> Page[CountedDrive]:
        """Return the drives whose slugs come after `after`; fewer where they have many gaps.

        Raises:
            MapNotFound: If there is no such map.
        """
        with self._database.reading() as session:
            query = (
                select(Drive)
                .where(_in_use(map_named(session, map_slug)), Drive.slug > after)
                .order_by(Drive.slug)
                .limit(one_more(limit))
            )
            records = _counted(session, session.scalars(query).all())
            return page_of(records, limit, lambda record: record.slug, _characters)

    def slugs(self, map_slug: str) -> tuple[str, ...]:
        """Return the slugs of all drives of a map, in their order.

        Raises:
            MapNotFound: If there is no such map.
        """
        with self._database.reading() as session:
            in_use = _in_use(map_named(session, map_slug))
            return tuple(session.scalars(select(Drive.slug).where(in_use).order_by(Drive.slug)))

    def of_map(self, map_id: str, slugs: Sequence[str] | None = None) -> Sequence[FilledDrive]:
        """Return drives of the map of that id in the given order, or all in that of their slugs.

        Raises:
            MapNotFound: If the map is gone.
            DriveNotFound: If it lacks one of the drives.
        """
        with self._database.reading() as session:
            of_map = map_of_id(session, map_id)
            query = select(Drive).where(_in_use(of_map)).order_by(Drive.slug)
            rows = {row.slug: row for row in session.scalars(query)}
            for slug in slugs or ():
                if slug not in rows:
                    raise DriveNotFound(f"map {of_map.slug!r} has no drive {slug[:80]!r}")
            return _filled(session, [rows[slug] for slug in slugs or rows])

    def counted(self, drives: Sequence[DriveRecord]) -> Sequence[CountedDrive]:
        """Return drives as they are now, with all counts, in the order of their slugs.

        Those that are gone are left out.
        """
        with self._database.reading() as session:
            kept = select(Drive).where(Drive.id.not_in(PURGED))
            found = _of_drives(session, kept, Drive.id, drives)
            rows = sorted((row for (row,) in found), key=lambda row: row.slug)
            return tuple(_counted(session, rows))

    def require(self, drive_id: str, slug: str) -> None:
        """Raise `DriveNotFound` if the drive of that id, which had this slug, is gone."""
        with self._database.reading() as session:
            row = session.get(Drive, drive_id)
            if row is None or is_recycled(row.slug):
                raise DriveNotFound(f"drive {slug!r} was deleted meanwhile")

    def with_id(self, drive_id: str) -> DriveRecord:
        """Return the drive of that id, also one that is in the recycle bin.

        Raises:
            DriveNotFound: If it is gone.
        """
        with self._database.reading() as session:
            row = session.get(Drive, drive_id)
            if row is None:
                raise DriveNotFound(f"the drive with id {drive_id} is gone")
            return DriveRecord(**_fields(row))

    def put(
        self, map_slug: str, slug: str, mounting: Mounting | None, accumulate: int
    ) -> tuple[CountedDrive, bool]:
        """Set how builds read a drive, which is made if it is new.

        Args:
            map_slug: The map.
            slug: The drive.
            mounting: The mounting of its sensor, `None` to remove it.
            accumulate: How many consecutive scans become one.

        Returns:
            The drive, and whether it is new.

        Raises:
            MapNotFound: If there is no such map.
            InvalidSlug: If the drive is new, and its name is no slug.
            InvalidParameters: If `accumulate` is out of range.
            ReturnsGone: If that is a change, and returns that builds would need were dropped.
        """
        require_count(accumulate)
        try:
            return self._put(map_slug, slug, mounting, accumulate)
        except IntegrityError:  # on databases with concurrent writers: another one made it
            return self._put(map_slug, slug, mounting, accumulate)

    def _put(
        self, map_slug: str, slug: str, mounting: Mounting | None, accumulate: int
    ) -> tuple[CountedDrive, bool]:
        values = None if mounting is None else asdict(mounting)
        with self._database.writing() as session:
            map_id = map_named(session, map_slug).id
            query = select(Drive).where(Drive.map_id == map_id, Drive.slug == checked_slug(slug))
            row = session.scalar(query.with_for_update())
            is_new = row is None
            if row is None:
                row = Drive(
                    id=new_id(),
                    map_id=map_id,
                    slug=slug,
                    created_at=datetime.now(UTC),
                )
                session.add(row)
            elif (row.mounting, row.accumulate) != (values, accumulate):
                require_returns(
                    session,
                    row,
                    "its images cannot be made for another mounting, upload it again under another"
                    " name",
                )
            row.mounting, row.accumulate = values, accumulate
            if not is_new:
                audit_chain.omit_if_unchanged(session, row)
        return self._counts_of(row), is_new

    def close(self, map_slug: str, slug: str) -> CountedDrive:
        """Close a drive: it accepts no more scans; a closed one stays closed.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
        """
        with self._database.writing() as session:
            row = drive_named(session, map_slug, slug, lock=True)
            row.closed = True
            audit_chain.omit_if_unchanged(session, row)
        return self._counts_of(row)

    def _counts_of(self, row: Drive) -> CountedDrive:
        """Return a drive with all counts, which are read outside of its change: it takes long."""
        with self._database.reading() as session:
            return next(_counted(session, [row]))

    def by_map(self) -> dict[str, set[str]]:
        """Return the ids of each map's drives, by the map's id; none of a map without.

        Also of those in the recycle bin: their files are still named.
        """
        found: dict[str, set[str]] = {}
        with self._database.reading() as session:
            query = select(Map.id, Drive.id).outerjoin(Drive, Drive.map_id == Map.id)
            for map_id, drive_id in session.execute(query):
                drives = found.setdefault(map_id, set())
                if drive_id is not None:
                    drives.add(drive_id)
        return found

    def slugs_by_id(self) -> dict[str, str]:
        """Return the slugs of all maps and of all drives, by their ids; deleted ones' as before."""
        with self._database.reading() as session:
            tables = (Map, Drive, Recycled)
            rows = (
                row for table in tables for row in session.execute(select(table.id, table.slug))
            )
            return {row.id: row.slug for row in rows}


def _in_use(of_map: Map) -> ColumnElement[bool]:
    """Return the condition of the drives of a map that are not in the recycle bin."""
    return and_(Drive.map_id == of_map.id, Drive.slug < RECYCLED)


def drive_named(session: Session, map_slug: str, slug: str, *, lock: bool = False) -> Drive:
    """Return the row of a drive, with `lock` locked until the transaction ends.

    Raises:
        MapNotFound: If there is no such map.
        DriveNotFound: If it has no such drive.
    """
    of_map = map_named(session, map_slug)
    query = select(Drive).where(Drive.map_id == of_map.id, Drive.slug == slug)
    row = session.scalar(query.with_for_update() if lock else query)
    if row is None or is_recycled(row.slug):
        raise DriveNotFound(f"map {map_slug!r} has no drive {slug[:80]!r}")
    return row


def require_returns(session: Session, row: Drive, why: str) -> None:
    """Raise `ReturnsGone`, for a reason, if returns of a drive were dropped."""
    of_drive = select(func.count()).where(Scan.drive_id == row.id)
    dropped = session.scalar(of_drive.where(Scan.chunk == "")) or 0
    if dropped:
        raise ReturnsGone(
            f"the returns of {dropped} of {session.scalar(of_drive)} scans of drive {row.slug!r}"
            f" were dropped after a build: {why}"
        )


def _filled(session: Session, rows: Sequence[Drive]) -> list[FilledDrive]:
    """Count the scans of drives, which takes their index alone."""
    counts = select(Scan.drive_id, func.count()).group_by(Scan.drive_id)
    found = _of_drives(session, counts, Scan.drive_id, rows)
    scans = {drive_id: int(count) for drive_id, count in found}
    expected = _expected(session, rows)
    return [
        FilledDrive(
            **_fields(row),
            scans=scans.get(row.id, 0),
            expected_poses=expected.get(row.id, 0),
        )
        for row in rows
    ]


def _counted(session: Session, rows: Sequence[Drive]) -> Iterator[CountedDrive]:
    """Count the scans of drives and what they have, in one pass if no index is missing.

    Else their ranges are read, of some drives at a time: of 1,000 they may have gigabytes.
    """
    is_dropped = case((Scan.chunk == "", 1), else_=0)
    sums = select(
        Scan.drive_id,
        func.count(),
        func.min(Scan.index),
        func.max(Scan.index),
        func.sum(Scan.returns),
        func.sum(is_dropped),
        func.sum(is_dropped * Scan.returns),
        func.sum(case((Scan.pose.is_(None), 0), else_=1)),
    ).group_by(Scan.drive_id)
    found = _of_drives(session, sums, Scan.drive_id, rows)
    totals = {drive_id: list(map(int, of_drive)) for drive_id, *of_drive in found}
    whole = {
        drive_id: [IndexRange(first, last)]
        for drive_id, (scans, first, last, *_) in totals.items()
        if last - first + 1 == scans
    }
    expected = _expected(session, rows)
    for at in range(0, len(rows), ROWS_AT_ONCE):
        some = rows[at : at + ROWS_AT_ONCE]
        gapped = [row.id for row in some if row.id in totals and row.id not in whole]
        present = whole | _ranges(session, gapped)
        for row in some:
            scans, _, _, returns, dropped, dropped_returns, posed = totals.get(row.id, [0] * 7)
            yield CountedDrive(
                **_fields(row),
                scans=scans,
                expected_poses=expected.get(row.id, 0),
                returns=returns,
                scans_without_returns=dropped,
                kept_returns=returns - dropped_returns,
                present=tuple(present.get(row.id, ())),
                scans_with_pose=posed,
            )


def _characters(drive: CountedDrive) -> int:
    """Return about what the JSON of a drive's ranges has, and of the gaps between them."""
    return 2 * 30 * len(drive.present)


def _ranges(session: Session, drive_ids: Sequence[str]) -> dict[str, list[IndexRange]]:
    """Return the ranges of indices of drives that lack some, in ascending order.

    Within a range without a gap, a scan's index minus its rank is constant.
    """
    found: dict[str, list[IndexRange]] = defaultdict(list)
    if not drive_ids:
        return found
    rank = func.row_number().over(partition_by=Scan.drive_id, order_by=Scan.index)
    ranked = (
        select(Scan.drive_id, Scan.index.label("at"), (Scan.index - rank).label("island"))
        .where(Scan.drive_id.in_(drive_ids))
        .subquery()
    )
    islands = (
        select(ranked.c.drive_id, func.min(ranked.c.at), func.max(ranked.c.at))
        .group_by(ranked.c.drive_id, ranked.c.island)
        .order_by(ranked.c.drive_id, func.min(ranked.c.at))
    )
    for drive_id, first, last in session.execute(islands):
        found[drive_id].append(IndexRange(int(first), int(last)))
    return found


def _expected(session: Session, rows: Sequence[Drive]) -> dict[str, int]:
    """Return how many poses of drives are of scans that are not stored yet, by the drives' ids."""
    waiting = (
        select(ExpectedPose.drive_id, func.count())
        .where(ExpectedPose.pose.is_not(None))
        .group_by(ExpectedPose.drive_id)
    )
    found = _of_drives(session, waiting, ExpectedPose.drive_id, rows)
    return {drive_id: int(count) for drive_id, count in found}


def _of_drives(
    session: Session,
    query: Select[*tuple[Any, ...]],
    drive_id: InstrumentedAttribute[str],
    drives: Sequence[Drive | DriveRecord],
) -> Iterator[Any]:
    """Yield the rows of a query that are of drives, by the column that has a drive's id."""
    for some in batches([drive.id for drive in drives]):
        yield from session.execute(query.where(drive_id.in_(some)))


def _fields(row: Drive) -> dict[str, Any]:
    """Return what the row of a drive has, by the names of the record's attributes."""
    return {
        "id": row.id,
        "map_id": row.map_id,
        "slug": row.slug,
        "created_at": row.created_at,
        "closed": row.closed,
        "mounting": None if row.mounting is None else Mounting(**row.mounting),
        "accumulate": row.accumulate,
        "odometry": row.odometry,
        "pose_check": row.pose_check,
    }
