"""Which capture of the catalog a new one is: an upload is resumed without its id."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from storage.catalog.capture_records import capture_summaries
from storage.catalog.models import Capture, Drive, JobRecord, JobState
from storage.catalog.records import NewCapture


def same_capture(
    session: Session, map_id: str, new: NewCapture, *, lock: bool = False
) -> Capture | None:
    """Return the newest capture with the same content for the same scans of a drive.

    One of the same topic if there is one, else one that takes parts: it can get another topic.
    """
    if new.digest is None:
        return None
    files = [list(file) for file in new.files]
    query = (
        select(Capture)
        .where(
            Capture.map_id == map_id,
            Capture.drive == new.drive,
            Capture.digest == new.digest,
            Capture.first_scan == new.first_scan,
        )
        .order_by(Capture.created_at.desc())
    )
    # One that is completed or deleted at the same time does not get another topic.
    rows = session.scalars(query.with_for_update() if lock else query).all()
    drive = session.scalar(select(Drive).where(Drive.map_id == map_id, Drive.slug == new.drive))
    receiving = None
    for row in rows:
        job = session.get(JobRecord, row.job_id) if row.job_id is not None else None
        is_unread = job is None or job.state != JobState.DONE
        is_stored = drive and job and _was_read_into(job, drive)
        if row.files != files or not (is_unread or is_stored):
            continue
        if new.topic in {None, row.topic}:
            return row
        if receiving is None and capture_summaries(session, [row])[0].takes_parts:
            receiving = row
    return receiving


def _was_read_into(job: JobRecord, drive: Drive) -> bool:
    """Return whether a job that read a capture stored its scans in a drive."""
    if "drive_id" in job.result:
        return bool(job.result["drive_id"] == drive.id)
    # Of an earlier version.
    return job.finished_at is not None and drive.created_at <= job.finished_at
