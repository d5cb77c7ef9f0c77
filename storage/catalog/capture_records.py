"""Rows of captures, and what the catalog returns of them."""

from collections.abc import Sequence

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from core.text import count_of
from storage.catalog.acts import SERVICE_ID, Act
from storage.catalog.models import Capture, CapturePart, JobRecord, Map, Recycled
from storage.catalog.records import CaptureRecord, CaptureState, CaptureSummary
from storage.index_ranges import IndexRange


def capture_record(session: Session, row: Capture) -> CaptureRecord:
    """Return a capture as its row and parts say."""
    received = _received(session, row.id)
    return CaptureRecord(**vars(capture_summaries(session, [row])[0]), received=received)


def _received(session: Session, capture_id: str) -> tuple[IndexRange, ...]:
    """Return the numbers of the stored parts: without a gap, number minus rank is constant."""
    rank = func.row_number().over(order_by=CapturePart.number)
    numbers = (
        select(CapturePart.number, (CapturePart.number - rank).label("island"))
        .where(CapturePart.capture_id == capture_id)
        .subquery()
    )
    first, last = func.min(numbers.c.number), func.max(numbers.c.number)
    islands = session.execute(select(first, last).group_by(numbers.c.island).order_by(first))
    return tuple(IndexRange(*ends) for ends in islands)


def capture_summaries(session: Session, rows: Sequence[Capture]) -> list[CaptureSummary]:
    """Return captures without the numbers of their parts, which are counted."""
    counted = (
        select(CapturePart.capture_id, func.count())
        .where(CapturePart.capture_id.in_([row.id for row in rows]))
        .group_by(CapturePart.capture_id)
    )
    received = dict(session.execute(counted).all())
    job_ids = [row.job_id for row in rows if row.job_id is not None]
    jobs = {
        job.id: job for job in session.scalars(select(JobRecord).where(JobRecord.id.in_(job_ids)))
    }
    return [
        CaptureSummary(
            id=row.id,
            map_id=row.map_id,
            drive=row.drive,
            files=tuple((str(name), int(size)) for name, size in row.files),
            size_bytes=row.size_bytes,
            part_bytes=row.part_bytes,
            topic=row.topic,
            first_scan=row.first_scan,
            digest=row.digest,
            created_at=row.created_at,
            touched_at=row.touched_at,
            parts_received=received.get(row.id, 0),
            job=None if row.job_id is None else jobs.get(row.job_id),
        )
        for row in rows
    ]


def expiries(session: Session, rows: Sequence[Capture]) -> list[Act]:
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
