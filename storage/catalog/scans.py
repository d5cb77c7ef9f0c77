"""Scans in the catalog: their chunk files, and the facts about them."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Any

import numpy as np
from sqlalchemy import bindparam, func, insert, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from core.numbers import nan_if_none
from core.scans.pose import Pose, is_known, pose_rows
from storage.catalog.computed_poses import forget_computed, store_computed
from storage.catalog.database import Repository
from storage.catalog.drives import drive_named
from storage.catalog.expected_poses import expect, forget, require_fit, with_expected
from storage.catalog.maps import no_map
from storage.catalog.models import Base, Drive, Map, Scan
from storage.catalog.pose_changes import change_poses
from storage.catalog.records import BYTES_PER_RETURN, PosesPut, ScanRecord
from storage.catalog.scan_poses import (
    ScanPoses,
    are_all_poses,
    at_indices,
    poses_from,
    stored_poses,
)
from storage.errors import LostRace, ScanNotFound
from storage.names import checked_slug, is_recycled, new_id

# Of every upload; made once, because making a statement takes longer than SQLite takes for it.
_DRIVE_TO_PUT_INTO = (
    select(Map.id, Drive.id, Drive.closed)
    .outerjoin(Drive, (Drive.map_id == Map.id) & (Drive.slug == bindparam("drive_slug")))
    .where(Map.slug == bindparam("map_slug"))
)
_HELD_DRIVE = (
    select(Drive.id, Drive.closed, Map.slug)
    .join(Map, Map.id == Drive.map_id)
    .where(Drive.map_id == bindparam("map_id"), Drive.slug == bindparam("drive_slug"))
    .with_for_update(of=Drive)
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


@dataclass(frozen=True)
class PutTarget:
    """The drive that scans are put into, and which of them it has already.

    Attributes:
        exists: Whether the drive exists; if not, `drive_id` is its future id.
        stored: The requested scans that are stored, by index.
    """

    map_id: str
    drive_id: str
    drive_slug: str
    exists: bool
    closed: bool
    stored: Mapping[int, ScanRecord]


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
                self._hold(session, target)
                records = with_expected(session, target.drive_id, records)
                if any(record.pose is not None for record in records):
                    forget_computed(session, session.get_one(Drive, target.drive_id))
                rows = [_values(target.drive_id, one) for one in records]
                session.connection().execute(_NEW_SCAN, rows)
                return list(records)
        except IntegrityError as error:  # one of the scans was added, or the drive
            raise LostRace(f"drive {target.drive_slug!r} changed meanwhile") from error

    @staticmethod
    def _hold(session: Session, target: PutTarget) -> None:
        """Lock the target's drive, or make it."""
        named = {"map_id": target.map_id, "drive_slug": target.drive_slug}
        found = session.connection().execute(_HELD_DRIVE, named).first()
        drive_id, closed, map_slug = found or (None, None, None)
        if found is None:  # the drive is to be made, or gone, perhaps with its map
            map_slug = session.scalar(select(Map.slug).where(Map.id == target.map_id))
        if map_slug is None or is_recycled(map_slug):
            raise LostRace(f"the map of drive {target.drive_slug!r} was removed meanwhile")
        if target.exists:
            if (drive_id, closed) != (target.drive_id, target.closed):
                raise LostRace(f"drive {target.drive_slug!r} was closed or removed meanwhile")
            return
        if found is not None:
            raise LostRace(f"drive {target.drive_slug!r} was made meanwhile")
        row = Drive(
            id=target.drive_id,
            map_id=target.map_id,
            slug=target.drive_slug,
            created_at=datetime.now(UTC),
        )
        session.add(row)
        session.flush()

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

    def of_chunk(self, drive_id: str, chunk: str) -> list[ScanRecord]:
        """Return the facts of the scans of a drive that are in a chunk file."""
        query = select(*_FACTS).where(Scan.drive_id == drive_id, Scan.chunk == chunk)
        with self._database.reading() as session:
            return [_record(*row) for row in session.execute(query.order_by(Scan.index))]

    def poses(self, drive_id: str, first: int, limit: int) -> ScanPoses:
        """Return poses and times of the first scans of a drive from an index on."""
        with self._database.reading() as session:
            return poses_from(session, drive_id, first, limit)

    def set_poses(
        self,
        map_slug: str,
        drive_slug: str,
        poses: Mapping[int, Pose | None],
        timestamps_s: Mapping[int, float] = MappingProxyType({}),
    ) -> PosesPut:
        """Set poses and timestamps of stored scans, also of closed drives: all or nothing.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
            ScanNotFound: If one of the scans is not stored; the message names the first.
            ReturnsGone: If that needs returns which were dropped; see `change_poses`.
        """
        indices = sorted({*poses, *timestamps_s})
        scans = np.array(indices, dtype=np.int64)
        with self._database.writing(announced=False) as session:
            drive = drive_named(session, map_slug, drive_slug, lock=True)
            before = stored_poses(session, drive.id, scans)
            if len(before) < len(scans):
                missing = np.setdiff1d(scans, before.scans)
                raise ScanNotFound(
                    f"drive {drive_slug!r} has no scan {missing[0]}"
                    f" ({len(missing)} of {len(indices)} are missing)"
                )
            posed = np.array([index in poses for index in indices], dtype=bool)
            after = ScanPoses(scans, before.poses.copy(), before.timestamps_s.copy())
            after.poses[posed] = pose_rows([poses[index] for index in indices if index in poses])
            for at, index in enumerate(indices):
                after.timestamps_s[at] = timestamps_s.get(index, before.timestamps_s[at])
            any_known = any(pose is not None for pose in poses.values())
            return change_poses(session, drive, before, after, posed, any_known=any_known)

    def expect_poses(
        self,
        target: PutTarget,
        poses: ScanPoses,
        *,
        partial: bool = False,
        with_scans: bool = False,
    ) -> PosesPut:
        """Set poses and timestamps of stored scans; keep those of scans that are not stored yet.

        Args:
            target: The drive.
            poses: The poses of all its scans, at least one; an unknown time is left as it is.
            partial: Set them even if they do not fit all scans; those of scans that a closed drive
                lacks are left over.
            with_scans: Whether they came with scans of the drive: more of them may follow.

        Raises:
            LostRace: If the target has changed.
            ScanNotFound: If the drive is closed and lacks one of the scans.
            PosesDoNotFit: If they cannot be those of the drive's scans.
            ReturnsGone: If that needs returns which were dropped; see `change_poses`.
        """
        slug, drive_id = target.drive_slug, target.drive_id
        try:
            with self._database.writing(announced=False) as session:
                self._hold(session, target)
                drive = session.get_one(Drive, drive_id)
                any_known = bool(is_known(poses.poses).any())
                before = stored_poses(session, drive_id, poses.scans)
                is_stored = np.isin(poses.scans, before.scans)
                missing = poses.only(~is_stored)
                if len(missing) and target.closed and not partial:
                    raise ScanNotFound(f"drive {slug!r} is closed without scan {missing.scans[0]}")
                if not partial:
                    last_index = select(func.max(Scan.index)).where(Scan.drive_id == drive_id)
                    last = session.scalar(last_index)
                    computed = drive.odometry is not None and any_known
                    require_fit(
                        slug,
                        poses,
                        before.without_poses() if computed else before,
                        last,
                        with_scans=with_scans,
                    )
                given = poses.only(is_stored)
                timed = np.isfinite(given.timestamps_s)
                timestamps_s = np.where(timed, given.timestamps_s, before.timestamps_s)
                after = ScanPoses(given.scans, given.poses, timestamps_s)
                all_of_them = np.ones(len(after), dtype=bool)
                put = change_poses(session, drive, before, after, all_of_them, any_known=any_known)
                extra = int(np.count_nonzero(is_known(missing.poses)))
                if target.closed:
                    forget(session, drive_id, missing.scans)
                    return replace(put, left_over=extra)
                expect(session, drive_id, missing)
                return replace(put, waiting=extra)
        except IntegrityError as error:  # on databases with concurrent writers
            raise LostRace(f"drive {slug!r} changed meanwhile") from error

    def set_computed(self, drive_id: str, poses: ScanPoses, odometry: Mapping[str, Any]) -> bool:
        """Set the poses of a drive's scans to computed ones: all or nothing.

        Args:
            drive_id: The drive.
            poses: The poses of the scans that it had, with their standard deviations.
            odometry: How they were computed, in plain values.

        Returns:
            False if nothing is set: the drive lacks some of them by now, has given poses, or is
            gone.
        """
        with self._database.writing(announced=False) as session:
            drive = session.get(Drive, drive_id, with_for_update=True)
            if drive is None or is_recycled(drive.slug):
                return False
            return store_computed(session, drive, poses, odometry)

    def set_pose_check(self, drive_id: str, poses: ScanPoses, check: Mapping[str, Any]) -> None:
        """Store how given poses of a drive agree with its scans, unless it has others by now."""
        with self._database.writing(announced=False) as session:
            drive = session.get(Drive, drive_id, with_for_update=True)
            if drive is not None and are_all_poses(session, drive_id, poses):
                drive.pose_check = dict(check)

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
            return old - chunks_of(session, drive_id)

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

    def chunks(self, drive_id: str) -> set[str]:
        """Return the names of the chunk files that hold the scans of a drive."""
        with self._database.reading() as session:
            return chunks_of(session, drive_id)


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
