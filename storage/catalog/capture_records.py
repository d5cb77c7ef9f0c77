"""Rows of captures, and what the catalog returns of them."""

from collections.abc import Sequence

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from storage.catalog.models import Capture, CapturePart, JobRecord
from storage.catalog.records import CaptureRecord, CaptureSummary
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
