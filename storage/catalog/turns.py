"""Whose job is next: keys take turns, and so do the maps of a key."""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime

from sqlalchemy import ColumnElement, func, select
from sqlalchemy.orm import Session

from storage.catalog.models import Job
from storage.catalog.records import JobState

_NEVER = datetime.min.replace(tzinfo=UTC)


@dataclass(frozen=True)
class _Share:
    """The jobs of one key for one map that wait.

    Attributes:
        key_id: Of the key; jobs of nobody's, from before keys were written down, are one share.
        map_id: Of the map.
        since: When the one was queued that has waited longest.
    """

    key_id: str | None
    map_id: str
    since: datetime


def next_job(session: Session) -> Job | None:
    """Return the job whose turn it is, locked; `None` if none waits.

    Of the keys that have jobs in the queue, it is the turn of that with the fewest running, then of
    that whose last job started longest ago; of that key's maps, of that whose last job for it
    started longest ago. A share's own jobs run in the order in which they were queued.
    """
    for share in _in_turn(session, _waiting(session)):
        job = session.scalar(
            select(Job)
            .where(Job.state == JobState.QUEUED, *_of(share.key_id, share.map_id))
            .order_by(Job.created_at, Job.id)
            .limit(1)
            .with_for_update(skip_locked=True)
        )
        if job is not None:  # else other workers hold all of them
            return job
    return None


def _waiting(session: Session) -> list[_Share]:
    query = (
        select(Job.key_id, Job.map_id, func.min(Job.created_at))
        .where(Job.state == JobState.QUEUED)
        .group_by(Job.key_id, Job.map_id)
    )
    return [_Share(*row) for row in session.execute(query)]


def _in_turn(session: Session, shares: list[_Share]) -> Iterable[_Share]:
    if len(shares) < 2:
        return shares
    keys = {share.key_id for share in shares}
    running = {key: _running(session, key) for key in keys}
    started = {key: _last_started(session, _of(key)) for key in keys}
    return sorted(
        shares,
        key=lambda share: (
            running[share.key_id],
            started[share.key_id],
            _last_started(session, _of(share.key_id, share.map_id)),
            share.since,
            share.map_id,
        ),
    )


def _running(session: Session, key_id: str | None) -> int:
    query = select(func.count()).where(Job.state == JobState.RUNNING, *_of(key_id))
    return session.scalar(query) or 0


def _last_started(session: Session, of: Iterable[ColumnElement[bool]]) -> datetime:
    return session.scalar(select(func.max(Job.started_at)).where(*of)) or _NEVER


def _of(key_id: str | None, map_id: str | None = None) -> list[ColumnElement[bool]]:
    of_key = [Job.key_id == key_id]  # of None this is IS NULL
    return of_key if map_id is None else [*of_key, Job.map_id == map_id]
