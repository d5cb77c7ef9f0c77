"""Drives in the catalog."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime

from sqlalchemy import ColumnElement, and_, case, delete, func, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from core.scans.accumulation import require_count
from core.scans.mounting import Mounting
from storage.catalog.database import Repository
from storage.catalog.maps import map_named, map_of_id
from storage.catalog.models import Drive, ExpectedPose, Map, Recycled, Scan
from storage.catalog.pages import DEFAULT_LIMIT, one_more, page_of
from storage.catalog.records import DriveRecord, Page
from storage.errors import DriveNotFound, ReturnsGone
from storage.index_ranges import IndexRange
from storage.names import RECYCLED, checked_slug, is_recycled, new_id


class Drives(Repository):
    """The drives of each map, in the order of their slugs."""

    def get(self, map_slug: str, slug: str) -> DriveRecord:
        """Return a drive.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
        """
        with self._database.reading() as session:
            return _records(session, [drive_named(session, map_slug, slug)])[0]

    def list(self, map_slug: str, after: str = "", limit: int = DEFAULT_LIMIT) -> Page[DriveRecord]:
        """Return the drives whose slugs come after `after`.

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
            records = _records(session, session.scalars(query).all())
        return page_of(records, limit, lambda record: record.slug)

    def slugs(self, map_slug: str) -> tuple[str, ...]:
        """Return the slugs of all drives of a map, in their order.

        Raises:
            MapNotFound: If there is no such map.
        """
        with self._database.reading() as session:
            in_use = _in_use(map_named(session, map_slug))
            return tuple(session.scalars(select(Drive.slug).where(in_use).order_by(Drive.slug)))

    def of_map(self, map_id: str, slugs: Sequence[str] | None = None) -> Sequence[DriveRecord]:
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
            return _records(session, [rows[slug] for slug in slugs or rows])

    def require(self, drive_id: str) -> None:
        """Raise `DriveNotFound` if the drive of that id is gone."""
        with self._database.reading() as session:
            row = session.get(Drive, drive_id)
            if row is None or is_recycled(row.slug):
                raise DriveNotFound(f"the drive with id {drive_id} is gone")

    def with_id(self, drive_id: str) -> DriveRecord:
        """Return the drive of that id, also one that is in the recycle bin.

        Raises:
            DriveNotFound: If it is gone.
        """
        with self._database.reading() as session:
            row = session.get(Drive, drive_id)
            if row is None:
                raise DriveNotFound(f"the drive with id {drive_id} is gone")
            return _records(session, [row])[0]

    def put(
        self, map_slug: str, slug: str, mounting: Mounting | None, accumulate: int
    ) -> tuple[DriveRecord, bool]:
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
    ) -> tuple[DriveRecord, bool]:
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
            session.flush()
            return _records(session, [row])[0], is_new

    def close(self, map_slug: str, slug: str) -> DriveRecord:
        """Close a drive: it accepts no more scans; a closed one stays closed.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
        """
        with self._database.writing() as session:
            row = drive_named(session, map_slug, slug, lock=True)
            row.closed = True
            return _records(session, [row])[0]

    def delete(self, map_slug: str, slug: str) -> DriveRecord:
        """Remove a drive and the facts about its scans for good; return its record.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
        """
        with self._database.writing() as session:
            row = drive_named(session, map_slug, slug, lock=True)
            record = _records(session, [row])[0]
            session.execute(delete(Drive).where(Drive.id == row.id))
            return record

    def known(self) -> set[tuple[str, str]]:
        """Return `(map id, drive id)` of every drive; the latter is empty for a map without.

        Also of those in the recycle bin: their files are still named.
        """
        with self._database.reading() as session:
            query = select(Map.id, Drive.id).outerjoin(Drive, Drive.map_id == Map.id)
            return {(map_id, drive_id or "") for map_id, drive_id in session.execute(query)}

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


def _records(session: Session, rows: Sequence[Drive]) -> list[DriveRecord]:
    """Count the scans of drives and find their ranges, in one query.

    Within a range without a gap, a scan's index minus its rank is constant.
    """
    rank = func.row_number().over(partition_by=Scan.drive_id, order_by=Scan.index)
    ranked = (
        select(
            Scan.drive_id,
            Scan.index.label("at"),
            Scan.returns,
            case((Scan.chunk == "", 1), else_=0).label("dropped"),
            case((Scan.pose.is_(None), 0), else_=1).label("posed"),
            (Scan.index - rank).label("island"),
        )
        .where(Scan.drive_id.in_([row.id for row in rows]))
        .subquery()
    )
    islands = (
        select(
            ranked.c.drive_id,
            func.min(ranked.c.at),
            func.max(ranked.c.at),
            func.sum(ranked.c.returns),
            func.sum(ranked.c.dropped),
            func.sum(ranked.c.dropped * ranked.c.returns),
            func.sum(ranked.c.posed),
        )
        .group_by(ranked.c.drive_id, ranked.c.island)
        .order_by(ranked.c.drive_id, func.min(ranked.c.at))
    )
    of_drive: dict[str, list[list[int]]] = defaultdict(list)
    for drive_id, *numbers in session.execute(islands):
        of_drive[drive_id].append([int(number) for number in numbers])
    waiting = (
        select(ExpectedPose.drive_id, func.count())
        .where(ExpectedPose.drive_id.in_([row.id for row in rows]), ExpectedPose.pose.is_not(None))
        .group_by(ExpectedPose.drive_id)
    )
    expected = {row[0]: int(row[1]) for row in session.execute(waiting)}
    return [_record(row, of_drive[row.id], expected.get(row.id, 0)) for row in rows]


def _record(row: Drive, islands: Sequence[Sequence[int]], expected_poses: int) -> DriveRecord:
    columns = list(zip(*islands, strict=True)) or [()] * 6
    firsts, lasts = columns[:2]
    returns, dropped_scans, dropped_returns, posed_scans = map(sum, columns[2:])
    return DriveRecord(
        row.id,
        row.map_id,
        row.slug,
        row.created_at,
        row.closed,
        scans=sum(lasts) - sum(firsts) + len(islands),
        returns=returns,
        dropped_scans=dropped_scans,
        kept_returns=returns - dropped_returns,
        present=tuple(map(IndexRange, firsts, lasts)),
        posed_scans=posed_scans,
        expected_poses=expected_poses,
        mounting=None if row.mounting is None else Mounting(**row.mounting),
        accumulate=row.accumulate,
        odometry=row.odometry,
        pose_check=row.pose_check,
    )
