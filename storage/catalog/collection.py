"""Removal of what a map's retention policy does not keep: revisions, and the returns of scans."""

from collections.abc import Collection
from dataclasses import asdict
from datetime import UTC, datetime

from sqlalchemy import Select, select, update
from sqlalchemy.orm import Session

from storage.catalog.database import Repository
from storage.catalog.maps import map_of_id
from storage.catalog.models import (
    OPEN_STATES,
    Drive,
    JobRecord,
    LiveRevision,
    Map,
    RevisionRecord,
    Scan,
)
from storage.catalog.records import DriveRecord
from storage.catalog.scan_poses import ScanPoses, have_same_poses, stored_poses
from storage.catalog.scans import chunks_of
from storage.errors import LostRace
from storage.names import is_recycled
from storage.retention import Candidate, OwnRetention, RawScans, Retention, to_collect


class Collector(Repository):
    """Removes what is not retained; that is checked in the transaction that removes it."""

    def collectable(
        self, map_id: str, default: Retention, now: datetime | None = None
    ) -> tuple[str, ...]:
        """Return the digests of the revisions that a map's policy does not keep, oldest first.

        Args:
            map_id: The map.
            default: What it keeps where it did not choose otherwise.
            now: The time, the present by default.

        Raises:
            MapNotFound: If the map is gone.
        """
        with self._database.reading() as session:
            of_map = map_of_id(session, map_id)
            return _collectable(session, of_map, default, now or datetime.now(UTC))

    def collect(self, map_id: str, digest: str, default: Retention) -> RevisionRecord:
        """Remove a revision that its map's policy does not keep; return its record.

        Raises:
            MapNotFound: If the map is gone.
            LostRace: If the revision is gone or is to be kept: it was made live meanwhile, a job
                is based on it, or the policy was changed.
        """
        with self._database.writing() as session:
            of_map = map_of_id(session, map_id, lock=True)
            if digest not in _collectable(session, of_map, default, datetime.now(UTC)):
                raise LostRace(f"revision {digest[:12]} is gone, or to be kept")
            revision = session.get_one(RevisionRecord, (map_id, digest))
            session.delete(revision)
            return revision

    def has_open_job(self, map_id: str) -> bool:
        """Return whether a job of a map is queued or running."""
        with self._database.reading() as session:
            return session.scalar(_open_jobs(map_id).limit(1)) is not None

    def drop_returns(
        self,
        live_revision: str,
        drive: DriveRecord,
        poses: ScanPoses,
        indices: Collection[int],
        default: Retention,
    ) -> set[str]:
        """Delete the location of the returns of scans; all else about them stays.

        Args:
            live_revision: The revision that must still be live: it was built of these scans.
            drive: The scans' drive, which must be closed, as it was when its images were read.
            poses: The poses that all its scans had then.
            indices: Indices of the scans.
            default: What the map keeps where it did not choose otherwise.

        Returns:
            The chunk files that no longer hold a scan.

        Raises:
            MapNotFound: If the map is gone.
            LostRace: If another revision is live, a queued or running job may need the returns, the
                drive is gone or open, what its images depend on was changed, or the policy keeps
                them.
        """
        with self._database.writing() as session:
            of_map = map_of_id(session, drive.map_id, lock=True)
            live = session.get(LiveRevision, of_map.id)
            row = session.get(Drive, drive.id, with_for_update=True)
            if (
                live is None
                or live.digest != live_revision
                or row is None
                or is_recycled(row.slug)
                or not row.closed
                or _policy(of_map, default).raw_scans != RawScans.DROP
                or session.scalar(_open_jobs(of_map.id).limit(1)) is not None
                or _needs_other_images(session, row, drive, poses)
            ):
                raise LostRace("the map changed meanwhile: returns will be dropped later")
            before = chunks_of(session, drive.id)
            if indices:
                session.execute(
                    update(Scan),
                    [
                        {"drive_id": drive.id, "index": index, "chunk": "", "row": 0}
                        for index in sorted(indices)
                    ],
                )
            return before - chunks_of(session, drive.id)


def _needs_other_images(session: Session, row: Drive, drive: DriveRecord, poses: ScanPoses) -> bool:
    """Return whether a closed drive has other images than it had with that record and poses."""
    mounting = None if drive.mounting is None else asdict(drive.mounting)
    if (row.mounting, row.accumulate) != (mounting, drive.accumulate):
        return True
    if row.accumulate == 1:  # each scan is projected by itself
        return False
    return not have_same_poses(poses, stored_poses(session, row.id, poses.scans))


def _policy(of_map: Map, default: Retention) -> Retention:
    return OwnRetention(**of_map.retention).over(default)


def _collectable(
    session: Session, of_map: Map, default: Retention, now: datetime
) -> tuple[str, ...]:
    policy = _policy(of_map, default)
    if policy.retained_revisions == "all":
        return ()
    live = session.get(LiveRevision, of_map.id)
    bases = _bases(session, of_map.id)
    revisions = session.scalars(select(RevisionRecord).where(RevisionRecord.map_id == of_map.id))
    candidates = [
        Candidate(
            revision.digest,
            revision.number,
            revision.retained_from or revision.created_at,
            live=live is not None and live.digest == revision.digest,
            needed=any(revision.digest.startswith(base) for base in bases),
        )
        for revision in revisions
    ]
    return to_collect(candidates, policy, now)


def _bases(session: Session, map_id: str) -> set[str]:
    """Return the digests, or prefixes of them, of the revisions that open jobs read."""
    bases: set[str | None] = set()
    for job in session.scalars(_open_jobs(map_id)):
        bases |= {job.parameters.get("base"), (job.plan or {}).get("basis_kept_from")}
    return {base for base in bases if base and base != "live"}


def _open_jobs(map_id: str) -> Select[JobRecord]:
    is_open = JobRecord.state.in_(OPEN_STATES)
    return select(JobRecord).where(JobRecord.map_id == map_id, is_open)
