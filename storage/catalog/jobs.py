"""Jobs in the catalog: a queue that survives a restart, in a fair order between keys.

queued --claim--> running --finish--> done
  |                  |-----fail----> failed
  |--request_cancel--|---cancelled-> cancelled
"""

from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from storage.catalog.database import Repository
from storage.catalog.maps import map_named
from storage.catalog.models import Job, Map
from storage.catalog.pages import DEFAULT_LIMIT, page_by_age
from storage.catalog.records import JobRecord, JobState, Page, RequestKey, record_of
from storage.catalog.turns import next_job
from storage.errors import JobNotFound, JobNotRunning, RequestKeyReused, TooManyBuilds
from storage.names import new_id


class Jobs(Repository):
    """The jobs of all maps, newest first."""

    def create(
        self,
        map_slug: str,
        parameters: Mapping[str, Any],
        *,
        plan: Mapping[str, Any] | None = None,
        kind: str = "build",
        request: RequestKey | None = None,
        key_id: str | None = None,
        most_queued: int | None = None,
    ) -> JobRecord:
        """Queue a job; one that the same request made already is returned as it is now.

        Args:
            map_slug: Of the map that it is for.
            parameters: What it is to do, as it was asked for.
            plan: The same with all that was left open chosen.
            kind: What it is.
            request: Which makes at most one job.
            key_id: Of the key that asks for it.
            most_queued: How many jobs that key may have in the queue. On PostgreSQL, requests for
                several maps at the same moment may get past it by one each.

        Raises:
            MapNotFound: If there is no such map.
            RequestKeyReused: If another request was made under this key.
            TooManyBuilds: If the key has as many queued as it may.
        """
        row = Job(
            id=new_id(),
            kind=kind,
            state=JobState.QUEUED,
            stage="",
            done_units=0,
            total_units=0,
            parameters=dict(parameters),
            plan=None if plan is None else dict(plan),
            cancel_requested=False,
            request_key=None if request is None else request.key,
            request_digest=None if request is None else request.digest,
            key_id=key_id,
            created_at=datetime.now(UTC),
        )
        try:
            return self._insert(map_slug, row, most_queued)
        except (IntegrityError, TooManyBuilds):
            made = None if request is None else self.made_by(map_slug, request)
            if made is None:
                raise
            return made

    def _insert(self, map_slug: str, row: Job, most_queued: int | None) -> JobRecord:
        with self._database.writing() as session:
            row.map_id = map_named(session, map_slug, shared=True).id
            if most_queued is not None:
                _require_room(session, row.key_id, most_queued)
            session.add(row)
            session.flush()
            return _record(row)

    def made_by(self, map_slug: str, request: RequestKey) -> JobRecord | None:
        """Return the job that this request made, `None` if it has made none yet.

        Raises:
            MapNotFound: If there is no such map.
            RequestKeyReused: If another request was made under this key.
        """
        with self._database.reading() as session:
            map_id = map_named(session, map_slug).id
            query = select(Job).where(Job.map_id == map_id, Job.request_key == request.key)
            row = session.scalar(query)
            if row is None:
                return None
            if row.request_digest != request.digest:
                raise RequestKeyReused(
                    f"the idempotency key {request.key!r} was used for job {row.id}, which was"
                    " asked for with other parameters"
                )
            return _record(row)

    def claim(self) -> JobRecord | None:
        """Start the next job; `None` if none waits.

        Keys take turns, and so do the maps of a key: `storage.catalog.turns`. No two callers are
        given the same job.
        """
        with self._database.writing() as session:
            row = next_job(session)
            if row is None:
                return None
            row.state = JobState.RUNNING
            row.started_at = datetime.now(UTC)
            session.flush()
            return _record(row)

    def get(self, job_id: str) -> JobRecord:
        """Return a job.

        Raises:
            JobNotFound: If there is none of that id.
        """
        with self._database.reading() as session:
            return _record(_found(session, job_id))

    def with_ids(self, job_ids: Collection[str]) -> Mapping[str, JobRecord]:
        """Return those of these jobs that are there, by their ids."""
        with self._database.reading() as session:
            rows = session.scalars(select(Job).where(Job.id.in_(job_ids)))
            return {row.id: _record(row) for row in rows}

    def list(
        self,
        map_slug: str | None = None,
        after: str = "",
        limit: int = DEFAULT_LIMIT,
        *,
        slugs: Collection[str] | None = None,
    ) -> Page[JobRecord]:
        """Return the jobs, of one map, of the maps `slugs` or all, that are older than `after`.

        Raises:
            MapNotFound: If there is no such map.
            InvalidParameters: If `after` is no job.
        """
        with self._database.reading() as session:
            query = select(Job)
            if map_slug is not None:
                query = query.where(Job.map_id == map_named(session, map_slug).id)
            if slugs is not None:
                query = query.where(Job.map_id.in_(select(Map.id).where(Map.slug.in_(slugs))))
            return page_by_age(session, query, Job.id, after, limit, _record)

    def counts(self) -> Mapping[JobState, int]:
        """Return how many jobs wait and run; those that ended are not counted."""
        query = (
            select(Job.state, func.count())
            .where(Job.state.in_([JobState.QUEUED, JobState.RUNNING]))
            .group_by(Job.state)
        )
        with self._database.reading() as session:
            return {JobState(state): count for state, count in session.execute(query)}

    def progress(self, job_id: str, stage: str, done_units: int, total_units: int) -> JobRecord:
        """Record how far a running job is; the answer tells whether it is asked to stop.

        Raises:
            JobNotFound: If there is none of that id.
            JobNotRunning: If it is not running.
        """
        with self._database.writing() as session:
            row = _running(session, job_id)
            if stage != row.stage:
                row.stage_started_at = datetime.now(UTC)
            row.stage, row.done_units, row.total_units = stage, done_units, total_units
            session.flush()
            return _record(row)

    def finish(self, job_id: str, revision: str) -> JobRecord:
        """End a running job that built `revision`; one that is done with it already stays so.

        Raises:
            JobNotFound: If there is none of that id.
            JobNotRunning: If it is not running.
        """
        with self._database.writing() as session:
            row = _found(session, job_id, lock=True)
            if (row.state, row.revision) != (JobState.DONE, revision):
                _finish_row(_running(session, job_id), revision)
            session.flush()
            return _record(row)

    def fail(self, job_id: str, error_type: str, error_detail: str) -> JobRecord:
        """End a running job that could not be done.

        Raises:
            JobNotFound: If there is none of that id.
            JobNotRunning: If it is not running.
        """
        return self._end(job_id, JobState.FAILED, error_type=error_type, error_detail=error_detail)

    def cancelled(self, job_id: str) -> JobRecord:
        """End a running job that stopped as asked.

        Raises:
            JobNotFound: If there is none of that id.
            JobNotRunning: If it is not running.
        """
        return self._end(job_id, JobState.CANCELLED)

    def _end(self, job_id: str, state: JobState, **facts: str) -> JobRecord:
        with self._database.writing() as session:
            row = _running(session, job_id)
            for name, value in facts.items():
                setattr(row, name, value)
            _end_row(row, state)
            session.flush()
            return _record(row)

    def request_cancel(self, job_id: str) -> JobRecord:
        """Cancel a waiting job, ask a running one to stop; one that has ended stays as it is.

        Raises:
            JobNotFound: If there is none of that id.
        """
        with self._database.writing() as session:
            row = _found(session, job_id, lock=True)
            if row.state == JobState.QUEUED:
                _end_row(row, JobState.CANCELLED)
            elif row.state == JobState.RUNNING:
                row.cancel_requested = True
            session.flush()
            return _record(row)

    def requeue_interrupted(self) -> int:
        """Queue again what ran when the server stopped; return how many jobs it was.

        A job that was asked to stop is cancelled instead. Only the server calls it, at its start,
        before a worker runs.
        """
        with self._database.writing() as session:
            rows = session.scalars(select(Job).where(Job.state == JobState.RUNNING)).all()
            for row in rows:
                if row.cancel_requested:
                    _end_row(row, JobState.CANCELLED)
                else:
                    row.state, row.stage, row.started_at = JobState.QUEUED, "", None
                    row.stage_started_at = None
                    row.done_units = row.total_units = 0
            return sum(row.state == JobState.QUEUED for row in rows)


def finish_if_running(
    session: Session,
    job_id: str,
    revision: str,
    notes: Sequence[str] = (),
    result: Mapping[str, Any] | None = None,
) -> None:
    """End a job that built `revision`, if it runs, within the transaction that publishes it."""
    row = session.get(Job, job_id, with_for_update=True)
    if row is not None and row.state == JobState.RUNNING:
        row.notes = list(notes)
        row.result = dict(result) if result else None
        _finish_row(row, revision)


def _finish_row(row: Job, revision: str) -> None:
    row.revision = revision
    _end_row(row, JobState.DONE)


def _end_row(row: Job, state: JobState) -> None:
    row.state = state
    row.finished_at = datetime.now(UTC)


def _require_room(session: Session, key_id: str | None, most_queued: int) -> None:
    query = select(func.count()).where(Job.state == JobState.QUEUED, Job.key_id == key_id)
    queued = session.scalar(query) or 0
    if queued >= most_queued:
        raise TooManyBuilds(
            f"key {key_id} has {queued} builds in the queue, as many as it may: wait until one has"
            " run, or cancel one"
        )


def _found(session: Session, job_id: str, *, lock: bool = False) -> Job:
    row = session.get(Job, job_id, with_for_update=lock)
    if row is None:
        raise JobNotFound(f"there is no job {job_id[:80]!r}")
    return row


def _running(session: Session, job_id: str) -> Job:
    row = _found(session, job_id, lock=True)
    if row.state != JobState.RUNNING:
        raise JobNotRunning(f"job {job_id} is {row.state}, not running")
    return row


def _record(row: Job) -> JobRecord:
    return record_of(
        JobRecord,
        row,
        state=JobState(row.state),
        notes=tuple(row.notes or ()),
        result=row.result or {},
    )
