"""The end of captures: the parts of those that were read are removed, and those that expired.

Some in a transaction: of 100,000 captures that expired at once, all in one held SQLite's only write
lock for 90 s, and PostgreSQL takes no statement of so many parameters.
"""

from collections.abc import Collection, Sequence
from datetime import datetime

from sqlalchemy import delete, exists, func, or_, select
from sqlalchemy.orm import Session

from core.text import count_of
from storage.catalog import audit_chain
from storage.catalog.acts import SERVICE_ID, Act
from storage.catalog.capture_records import capture_summaries
from storage.catalog.models import (
    OPEN_STATES,
    PURGED,
    Capture,
    CapturePart,
    JobRecord,
    JobState,
    Map,
    Recycled,
)
from storage.catalog.records import CaptureState

_AT_ONCE = 200  # captures: 0.2 s of SQLite's lock
_OF_JOB = Capture.job_id == JobRecord.id


def clear_read(session: Session) -> Collection[tuple[str, str]]:
    """Remove the parts of captures that were read, some at a time; return map and id of each."""
    read = select(Capture).join(JobRecord, _OF_JOB).where(JobRecord.state == JobState.DONE)
    has_parts = exists().where(CapturePart.capture_id == Capture.id)  # `in_` reads all parts
    emptied = session.scalars(read.where(has_parts).limit(_AT_ONCE)).all()
    if not emptied:
        return ()
    ids = [row.id for row in emptied]
    session.execute(delete(CapturePart).where(CapturePart.capture_id.in_(ids)))
    return {(row.map_id, row.id) for row in emptied}


def clear_expired(session: Session, before: datetime) -> Collection[tuple[str, str]]:
    """Remove captures that expired, some at a time; return map and id of each.

    Args:
        session: The transaction.
        before: They were touched last, and their job ended, before this.
    """
    expired = session.scalars(
        select(Capture)
        .outerjoin(JobRecord, _OF_JOB)
        # One that is completed at the same time is locked, or no longer that old.
        .with_for_update(of=Capture, skip_locked=True)
        .where(
            Capture.touched_at < before,
            Capture.map_id.not_in(PURGED),
            or_(
                JobRecord.id.is_(None),
                JobRecord.state.not_in(OPEN_STATES) & (JobRecord.finished_at < before),
            ),
        )
        .limit(_AT_ONCE)
    ).all()
    if not expired:
        return ()
    unread = _expiries(session, expired)
    session.execute(delete(Capture).where(Capture.id.in_([row.id for row in expired])))
    for act in unread:
        audit_chain.append(session, act, audit_chain.DONE)
    return {(row.map_id, row.id) for row in expired}


def _expiries(session: Session, rows: Sequence[Capture]) -> list[Act]:
    """Return what the audit log gets of captures that expire: those that were not read."""
    unread = [one for one in capture_summaries(session, rows) if one.state != CaptureState.DONE]
    named = select(Map.id, func.coalesce(Recycled.slug, Map.slug)).outerjoin(
        Recycled, Recycled.id == Map.id
    )
    query = named.where(Map.id.in_([capture.map_id for capture in unread]))
    slugs = dict(session.execute(query).all())
    return [
        Act(
            SERVICE_ID,
            "expire_capture",
            f"/v1/maps/{slugs[capture.map_id]}/drives/{capture.drive}/captures/{capture.id}",
            slugs[capture.map_id],
            f"{capture.files[0][0]}, {count_of(capture.parts_received, 'part')}",
        )
        for capture in unread
    ]
