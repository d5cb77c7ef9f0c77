"""The queue of jobs: the room of each key in it, and which job is next, fairly between keys."""

from datetime import UTC, datetime

from sqlalchemy import ColumnElement, func, select
from sqlalchemy.orm import Session

from core.text import count_of
from storage.catalog.key_lock import lock_key
from storage.catalog.models import JobRecord, JobState
from storage.errors import TooManyBuilds

_NEVER = datetime.min.replace(tzinfo=UTC)


def queue_job(session: Session, job: JobRecord, most_queued: int | None) -> None:
    """Queue a job within a transaction.

    Raises:
        TooManyBuilds: If its key's limit of queued jobs is reached.
    """
    if most_queued is not None:
        _require_room(session, job.key_id, most_queued)
    job.number = (session.scalar(select(func.max(JobRecord.number))) or 0) + 1
    session.add(job)
    session.flush()
    session.refresh(job, ["map_slug"])


def next_job(session: Session) -> JobRecord | None:
    """Return the job whose turn it is, locked; `None` if none is queued.

    The jobs of one key for one map are a share; jobs without a key, of earlier versions, are of one
    key. Shares are ordered by: the fewest running jobs of the key, the longest time since the key's
    last job started, the same of the share, the longest wait. A share's jobs run in the order in
    which they were queued.
    """
    queued = JobRecord.state == JobState.QUEUED
    query = select(JobRecord.key_id, JobRecord.map_id, func.min(JobRecord.number))
    shares = session.execute(query.where(queued).group_by(JobRecord.key_id, JobRecord.map_id)).all()
    if len(shares) > 1:
        ranks = {key_id: _rank(session, key_id) for key_id in {share.key_id for share in shares}}
        shares = sorted(
            shares,
            key=lambda share: (
                *ranks[share.key_id],
                _last_started(session, _of(share.key_id, share.map_id)),
                share[2],
                share.map_id,
            ),
        )
    for key_id, map_id, _ in shares:
        job = session.scalar(
            select(JobRecord)
            .where(queued, *_of(key_id, map_id))
            .order_by(JobRecord.number, JobRecord.id)
            .limit(1)
            .with_for_update(skip_locked=True)
        )
        if job is not None:  # else other workers hold all of them
            return job
    return None


def _rank(session: Session, key_id: str | None) -> tuple[int, datetime]:
    """Return the number of running jobs of a key, and when its last one started."""
    running = select(func.count()).where(JobRecord.state == JobState.RUNNING, *_of(key_id))
    return session.scalar(running) or 0, _last_started(session, _of(key_id))


def _last_started(session: Session, conditions: list[ColumnElement[bool]]) -> datetime:
    return session.scalar(select(func.max(JobRecord.started_at)).where(*conditions)) or _NEVER


def _of(key_id: str | None, map_id: str | None = None) -> list[ColumnElement[bool]]:
    of_key = [JobRecord.key_id == key_id]  # of None this is IS NULL
    return of_key if map_id is None else [*of_key, JobRecord.map_id == map_id]


def _require_room(session: Session, key_id: str | None, most_queued: int) -> None:
    lock_key(session, "jobs", key_id)
    of_key = JobRecord.key_id == key_id
    query = select(func.count()).where(JobRecord.state == JobState.QUEUED, of_key)
    queued = session.scalar(query) or 0
    if queued >= most_queued:
        raise TooManyBuilds(
            f"key {key_id} has reached the limit of {count_of(most_queued, 'queued job')}: wait"
            " until one has run, or cancel one"
        )
