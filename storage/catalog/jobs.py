"""Jobs in the catalog: their states, which survive a restart.

queued --claim--> running --finish--> done
  |                  |-----fail----> failed
  |--request_cancel--|---cancelled-> cancelled
"""

from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from core.text import shortened
from storage.catalog.batches import batches
from storage.catalog.database import Repository
from storage.catalog.job_queue import next_job, queue_job
from storage.catalog.maps import map_named
from storage.catalog.models import OPEN_STATES, PURGED, JobRecord, JobState, Map
from storage.catalog.pages import DEFAULT_LIMIT, page_by_age
from storage.catalog.records import IdempotencyKey, Page, RevisionFacts
from storage.errors import JobNotFound, JobNotRunning, RequestKeyReused, TooManyBuilds
from storage.names import RECYCLED, new_id

# Of an error or note, which may have what a recording says, in each list of jobs: 4 MB of 1,000.
_MOST_CHARACTERS = 4000
_NOT_PURGED = JobRecord.map_id.not_in(PURGED)


class Jobs(Repository):
    """The jobs of all maps, newest first; those of a deleted map are found by their ids only."""

    def create(
        self,
        map_slug: str,
        parameters: Mapping[str, Any],
        *,
        plan: Mapping[str, Any] | None = None,
        idempotency_key: IdempotencyKey | None = None,
        key_id: str | None = None,
        most_queued: int | None = None,
    ) -> JobRecord:
        """Queue a job; a repeated request returns the job that it made before, as it is now.

        Args:
            map_slug: The map.
            parameters: What the job is to do, as requested.
            plan: The same with every default resolved.
            idempotency_key: The request's; equal requests of one `key_id` make at most one job.
            key_id: Id of the key that requests it.
            most_queued: Maximum number of queued jobs of that key.

        Raises:
            MapNotFound: If there is no such map.
            RequestKeyReused: If another request was made under this key.
            TooManyBuilds: If the key's limit of queued jobs is reached.
        """
        job = JobRecord(
            id=new_id(),
            map_id="",
            parameters=dict(parameters),
            plan=None if plan is None else dict(plan),
            request_key=None if idempotency_key is None else idempotency_key.name,
            request_digest=None if idempotency_key is None else idempotency_key.digest,
            key_id=key_id,
            created_at=datetime.now(UTC),
        )
        try:
            with self._database.writing(announced=False) as session:
                job.map_id = map_named(session, map_slug, shared=True).id
                queue_job(session, job, most_queued)
        except (IntegrityError, TooManyBuilds):
            made = (
                None if idempotency_key is None else self.made_by(map_slug, idempotency_key, key_id)
            )
            if made is None:
                raise
            return made
        return job

    def made_by(
        self, map_slug: str, idempotency_key: IdempotencyKey, key_id: str | None
    ) -> JobRecord | None:
        """Return the job that this request of a key made, `None` if it has made none yet.

        Raises:
            MapNotFound: If there is no such map.
            RequestKeyReused: If another request was made under this key.
        """
        with self._database.reading() as session:
            query = select(JobRecord).where(
                JobRecord.map_id == map_named(session, map_slug).id,
                JobRecord.request_key == idempotency_key.name,
                JobRecord.key_id == key_id,
            )
            job = session.scalar(query)
            if job is not None and job.request_digest != idempotency_key.digest:
                raise RequestKeyReused(
                    f"the idempotency key {idempotency_key.name!r} was used for job {job.id}, which"
                    " was requested with other parameters"
                )
            return job

    def claim(self, started_at: datetime | None = None) -> JobRecord | None:
        """Start the next job; `None` if none is queued.

        Keys take turns, and so do the maps of a key. No two callers get the same job.

        Args:
            started_at: The time of its start, the present by default: if the commit gets no answer,
                `started_at` finds the job by it.
        """
        with self._database.writing(announced=False) as session:
            job = next_job(session)
            if job is not None:
                job.state = JobState.RUNNING
                job.started_at = started_at or datetime.now(UTC)
            return job

    def started_at(self, time: datetime) -> JobRecord | None:
        """Return the running job that was started at this time, `None` if there is none."""
        is_running = JobRecord.state == JobState.RUNNING
        with self._database.reading() as session:
            query = select(JobRecord).where(is_running, JobRecord.started_at == time)
            return session.scalar(query.limit(1))

    def get(self, job_id: str) -> JobRecord:
        """Return a job.

        Raises:
            JobNotFound: If there is none of that id.
        """
        with self._database.reading() as session:
            job = session.scalar(select(JobRecord).where(JobRecord.id == job_id, _NOT_PURGED))
            if job is None:
                raise _no_job(job_id)
            return job

    def with_ids(self, job_ids: Collection[str]) -> Mapping[str, JobRecord]:
        """Return those of these jobs that exist, by their ids."""
        found: dict[str, JobRecord] = {}
        with self._database.reading() as session:
            for some in batches(tuple(job_ids)):
                query = select(JobRecord).where(JobRecord.id.in_(some), _NOT_PURGED)
                found.update((job.id, job) for job in session.scalars(query))
        return found

    def list(
        self,
        map_slug: str | None = None,
        after: str = "",
        limit: int = DEFAULT_LIMIT,
        *,
        slugs: Collection[str] | None = None,
        states: Collection[JobState] | None = None,
    ) -> Page[JobRecord]:
        """Return the jobs that are older than `after`, without those of deleted maps.

        Args:
            map_slug: Only those of this map.
            after: Cursor of a job, empty for the first page.
            limit: Number of jobs.
            slugs: Only those of these maps.
            states: Only those in one of these states.

        Raises:
            MapNotFound: If there is no such map.
            InvalidParameters: If `after` is no cursor of such a list.
        """
        with self._database.reading() as session:
            query = select(JobRecord).join(Map, Map.id == JobRecord.map_id)
            query = query.where(Map.slug < RECYCLED)
            if map_slug is not None:
                query = query.where(JobRecord.map_id == map_named(session, map_slug).id)
            if slugs is not None:
                query = query.where(Map.slug.in_(slugs))
            if states is not None:
                query = query.where(JobRecord.state.in_(states))
            return page_by_age(session, query, JobRecord.id, after, limit, numbered=True)

    def counts(self) -> Mapping[JobState, int]:
        """Return the number of queued and of running jobs, by state."""
        query = (
            select(JobRecord.state, func.count())
            .where(JobRecord.state.in_(OPEN_STATES))
            .group_by(JobRecord.state)
        )
        with self._database.reading() as session:
            return dict(session.execute(query).all())

    def progress(self, job_id: str, stage: str, done_units: int, total_units: int) -> JobRecord:
        """Record the progress of a running job; `cancel_requested` of the answer is up to date.

        Raises:
            JobNotFound: If there is none of that id.
            JobNotRunning: If it is not running.
        """
        with self._database.writing(announced=False) as session:
            job = _running(session, job_id)
            if (stage, total_units) != (job.stage, job.total_units) or done_units < job.done_units:
                # also a stage that begins again, as each does with the next drive
                job.stage_started_at = datetime.now(UTC)
            job.stage, job.done_units, job.total_units = stage, done_units, total_units
            return job

    def finish(
        self,
        job_id: str,
        revision: str | None,
        *,
        notes: Sequence[str] = (),
        result: Mapping[str, Any] = MappingProxyType({}),
    ) -> JobRecord:
        """End a running job that built `revision`; one that ended so before stays as it is.

        Args:
            job_id: The job.
            revision: Digest of what it built, `None` for a job that is no build.
            notes: Remarks on what it did, of which the begin and the end are kept.
            result: What it found, in plain values.

        Raises:
            JobNotFound: If there is none of that id.
            JobNotRunning: If it is not running.
        """
        with self._database.writing(announced=False) as session:
            job = _found(session, job_id, lock=True)
            if (job.state, job.revision) != (JobState.DONE, revision):
                _finish(_running(session, job_id), revision, notes, result)
            return job

    def fail(self, job_id: str, error_type: str, error_detail: str) -> JobRecord:
        """End a running job that failed; one that was to be cancelled is cancelled instead.

        Args:
            job_id: The job.
            error_type: Name of the error's class.
            error_detail: Its text, of which the begin and the end are kept.

        Raises:
            JobNotFound: If there is none of that id.
            JobNotRunning: If it is not running.
        """
        with self._database.writing(announced=False) as session:
            job = _running(session, job_id)
            if job.cancel_requested:  # also with its map, so that it could not go on
                return _end(job, JobState.CANCELLED)
            job.error_type = error_type
            job.error_detail = shortened(error_detail, _MOST_CHARACTERS)
            return _end(job, JobState.FAILED)

    def cancelled(self, job_id: str) -> JobRecord:
        """End a running job that was cancelled.

        Raises:
            JobNotFound: If there is none of that id.
            JobNotRunning: If it is not running.
        """
        with self._database.writing(announced=False) as session:
            return _end(_running(session, job_id), JobState.CANCELLED)

    def request_cancel(self, job_id: str) -> JobRecord:
        """Cancel a queued job, or request the end of a running one; an ended one stays as it is.

        Raises:
            JobNotFound: If there is none of that id.
        """
        job = self.get(job_id)
        if job.ended:  # nothing to log as a change
            return job
        with self._database.writing(announced=False) as session:
            cancel_job(session, job_id)
            return _found(session, job_id)

    def requeue(self, job_id: str) -> JobRecord:
        """Queue a running job again, which a stop interrupts; one to be cancelled is cancelled.

        Raises:
            JobNotFound: If there is none of that id.
            JobNotRunning: If it is not running.
        """
        with self._database.writing(announced=False) as session:
            return _requeue(_running(session, job_id))

    def requeue_interrupted(self) -> int:
        """Queue again what ran when the server ended; return the number of these jobs.

        A stop leaves no running job: what runs may have ended the server, and counts a crash. A job
        that was to be cancelled is cancelled instead. Only the server calls it, at its start,
        before a worker runs.
        """
        with self._database.writing(announced=False) as session:
            query = select(JobRecord).where(JobRecord.state == JobState.RUNNING)
            jobs = session.scalars(query).all()
            for job in jobs:
                job.crashes += 1
                _requeue(job)
            return sum(job.state == JobState.QUEUED for job in jobs)


def finish_if_running(session: Session, job_id: str, revision: str, facts: RevisionFacts) -> None:
    """End a job that built `revision`, if it runs, within the transaction that publishes it."""
    job = session.get(JobRecord, job_id, with_for_update=True)
    if job is not None and job.state == JobState.RUNNING:
        _finish(job, revision, facts.notes, facts.job_result)


def cancel_job(session: Session, job_id: str) -> None:
    """Cancel a queued job, or request the end of a running one, within a transaction."""
    job = session.get(JobRecord, job_id, with_for_update=True)
    if job is not None and job.state == JobState.QUEUED:
        _end(job, JobState.CANCELLED)
    elif job is not None and job.state == JobState.RUNNING:
        job.cancel_requested = True


def _requeue(job: JobRecord) -> JobRecord:
    if job.cancel_requested:
        return _end(job, JobState.CANCELLED)
    job.state, job.stage = JobState.QUEUED, ""
    job.started_at = job.stage_started_at = None
    job.done_units = job.total_units = 0
    return job


def _finish(
    job: JobRecord, revision: str | None, notes: Sequence[str], result: Mapping[str, Any]
) -> None:
    job.revision, job.result = revision, dict(result)
    job.notes = [shortened(note, _MOST_CHARACTERS) for note in notes]
    _end(job, JobState.DONE)


def _end(job: JobRecord, state: JobState) -> JobRecord:
    job.state = state
    job.finished_at = datetime.now(UTC)
    return job


def _found(session: Session, job_id: str, *, lock: bool = False) -> JobRecord:
    job = session.get(JobRecord, job_id, with_for_update=lock)
    if job is None:
        raise _no_job(job_id)
    return job


def _no_job(job_id: str) -> JobNotFound:
    return JobNotFound(f"there is no job {job_id[:80]!r}")


def _running(session: Session, job_id: str) -> JobRecord:
    job = _found(session, job_id, lock=True)
    if job.state != JobState.RUNNING:
        raise JobNotRunning(f"job {job_id} is {job.state}, not running")
    return job
