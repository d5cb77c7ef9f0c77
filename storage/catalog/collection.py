"""What the catalog lets go as a map's policy asks: revisions, and the returns of scans."""

from collections.abc import Collection
from datetime import UTC, datetime

from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session

from storage.catalog.database import Repository
from storage.catalog.maps import map_of_id
from storage.catalog.models import Drive, Job, LiveRevision, Map, Revision, Scan
from storage.catalog.records import JobState, RevisionRecord
from storage.catalog.revisions import revision_record
from storage.catalog.scans import LostRace, chunks_of
from storage.retention import OwnRetention, RawScans, Retention, Standing, to_collect

_OPEN = (JobState.QUEUED, JobState.RUNNING)


class Collector(Repository):
    """Removes what is not retained, and only what still is not when it is removed."""

    def collectable(
        self, map_id: str, default: Retention, now: datetime | None = None
    ) -> tuple[str, ...]:
        """Return the digests of the revisions that a map's policy does not keep, oldest first.

        Args:
            map_id: The map.
            default: What it keeps where it did not choose otherwise.
            now: The moment that it is asked for.

        Raises:
            MapNotFound: If the map is gone.
        """
        with self._database.reading() as session:
            of_map = map_of_id(session, map_id)
            return _collectable(session, of_map, default, now or datetime.now(UTC))

    def collect(
        self, map_id: str, digest: str, default: Retention, now: datetime | None = None
    ) -> RevisionRecord:
        """Remove a revision that its map's policy does not keep; return what it was.

        Raises:
            MapNotFound: If the map is gone.
            LostRace: If the revision is gone, or kept after all: it was made live meanwhile, a job
                was based on it, or the policy is another.
        """
        with self._database.writing() as session:
            of_map = map_of_id(session, map_id, lock=True)
            if digest not in _collectable(session, of_map, default, now or datetime.now(UTC)):
                raise LostRace(f"revision {digest[:12]} is kept after all, or gone")
            row = session.get_one(Revision, (map_id, digest))
            record = revision_record(row)
            session.execute(
                delete(Revision).where(Revision.map_id == map_id, Revision.digest == digest)
            )
            return record

    def has_open_job(self, map_id: str) -> bool:
        """Return whether a job of a map waits or runs."""
        with self._database.reading() as session:
            return _open_job(session, map_id)

    def drop_returns(
        self,
        map_id: str,
        live_revision: str,
        drive_id: str,
        indices: Collection[int],
        default: Retention,
    ) -> set[str]:
        """Let the catalog forget where the returns of scans are; all else about them stays.

        Args:
            map_id: The map.
            live_revision: The revision that must still be live: it was built of these scans.
            drive_id: Their drive, which must be closed.
            indices: Of the scans.
            default: What the map keeps where it did not choose otherwise.

        Returns:
            The chunk files that hold no scan any more.

        Raises:
            MapNotFound: If the map is gone.
            LostRace: If another revision is live, a job waits or runs that may need the returns,
                the drive is gone or open, or the policy keeps them.
        """
        with self._database.writing() as session:
            of_map = map_of_id(session, map_id, lock=True)
            live = session.get(LiveRevision, of_map.id)
            drive = session.get(Drive, drive_id, with_for_update=True)
            if (
                live is None
                or live.digest != live_revision
                or drive is None
                or not drive.closed
                or _policy(of_map, default).raw_scans != RawScans.DROP
                or _open_job(session, of_map.id)
            ):
                raise LostRace("the map changed meanwhile: returns are dropped another time")
            before = chunks_of(session, drive_id)
            if indices:
                session.execute(
                    update(Scan),
                    [
                        {"drive_id": drive_id, "index": index, "chunk": "", "row": 0}
                        for index in sorted(indices)
                    ],
                )
            return before - chunks_of(session, drive_id)


def _policy(of_map: Map, default: Retention) -> Retention:
    return OwnRetention.from_chosen(of_map.retention or {}).over(default)


def _collectable(
    session: Session, of_map: Map, default: Retention, now: datetime
) -> tuple[str, ...]:
    policy = _policy(of_map, default)
    if policy.retained_revisions == "all":
        return ()
    live = session.get(LiveRevision, of_map.id)
    bases = _bases(session, of_map.id)
    query = select(Revision.digest, Revision.created_at, Revision.retained_from)
    standing = [
        Standing(
            digest,
            created_at,
            retained_from or created_at,
            live=live is not None and live.digest == digest,
            needed=any(digest.startswith(base) for base in bases),
        )
        for digest, created_at, retained_from in session.execute(
            query.where(Revision.map_id == of_map.id)
        )
    ]
    return to_collect(standing, policy, now)


def _bases(session: Session, map_id: str) -> set[str]:
    """Return the digests, or prefixes of them, of what jobs that wait or run read."""
    query = select(Job.parameters, Job.plan).where(Job.map_id == map_id, Job.state.in_(_OPEN))
    bases: set[str | None] = set()
    for parameters, plan in session.execute(query):
        bases |= {parameters.get("base"), (plan or {}).get("basis_kept_from")}
    return {base for base in bases if base and base != "live"}


def _open_job(session: Session, map_id: str) -> bool:
    query = select(Job.id).where(Job.map_id == map_id, Job.state.in_(_OPEN)).limit(1)
    return session.scalar(query) is not None
