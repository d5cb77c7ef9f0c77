"""Tables of jobs, and of captures that become scans."""

from datetime import datetime
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    ForeignKey,
    Index,
    func,
    select,
)
from sqlalchemy.orm import (
    Mapped,
    column_property,
    mapped_column,
)

from storage.catalog.columns import (
    Digest,
    Id,
    JsonOrNull,
    PlainString,
    PlainText,
    Slug,
    Values,
)
from storage.catalog.models.base import OPEN_STATES, Base, JobState
from storage.catalog.models.maps import Map, Recycled

BUILD, CAPTURE = "build", "capture"
"""Kinds of jobs."""


class JobRecord(Base):
    """A long computation for a map, and its progress.

    Attributes:
        stage: What it does now, in a word.
        done_units: How many of `total_units` are done in this stage.
        plan: What it does, with every default of `parameters` resolved when it was queued; `None`
            for a job that an earlier version queued.
        error_type: Name of the error it failed with.
        revision: Digest of the revision it built; not a foreign key: it outlives the revision.
        cancel_requested: Whether a running job is to stop.
        notes: Remarks on what it built.
        result: What it decided about it, in plain values.
        request_key: Idempotency key of the request that made it; the same request of the same
            `key_id` returns it.
        key_id: Id of the key that requested it; not a foreign key: the operator's is in no table.
            `None` for a job of an earlier version.
        number: Counts the jobs in the order in which they were queued, whatever the clock said; on
            databases with concurrent writers two may have the same.
        crashes: How many times the service ended without a stop while it ran.
        stage_started_at: Start of this stage, of a running job that reported one.
        map_slug: Name of its map when the job was read; of a deleted map, the name that it had.
    """

    __tablename__ = "jobs"
    __table_args__ = (
        Index(None, "number", "id"),
        Index(None, "state", "number"),
        Index(None, "key_id", "started_at"),
        Index("ix_jobs_request_key", "map_id", "request_key", "key_id", unique=True),
    )

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    map_id: Mapped[str] = mapped_column(Id, ForeignKey("maps.id", ondelete="CASCADE"), index=True)
    parameters: Mapped[dict[str, Any]] = mapped_column(JSON)
    created_at: Mapped[datetime]
    kind: Mapped[str] = mapped_column(PlainString(32), default=BUILD)
    state: Mapped[JobState] = mapped_column(default=JobState.QUEUED)
    stage: Mapped[str] = mapped_column(PlainString(64), default="")
    done_units: Mapped[int] = mapped_column(BigInteger, default=0)
    total_units: Mapped[int] = mapped_column(BigInteger, default=0)
    plan: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True), default=None)
    error_type: Mapped[str | None] = mapped_column(PlainString(128), default=None)
    error_detail: Mapped[str | None] = mapped_column(PlainText(), default=None)
    revision: Mapped[str | None] = mapped_column(Digest, default=None)
    cancel_requested: Mapped[bool] = mapped_column(default=False)
    notes: Mapped[list[str]] = mapped_column(JsonOrNull(list), nullable=True, default_factory=list)
    result: Mapped[dict[str, Any]] = mapped_column(Values, nullable=True, default_factory=dict)
    request_key: Mapped[str | None] = mapped_column(PlainString(255), default=None)
    request_digest: Mapped[str | None] = mapped_column(Digest, default=None)
    key_id: Mapped[str | None] = mapped_column(Id, default=None)
    crashes: Mapped[int] = mapped_column(server_default="0", default=0)
    number: Mapped[int] = mapped_column(BigInteger, server_default="0", default=0)
    started_at: Mapped[datetime | None] = mapped_column(default=None)
    stage_started_at: Mapped[datetime | None] = mapped_column(default=None)
    finished_at: Mapped[datetime | None] = mapped_column(default=None)
    map_slug: Mapped[str] = column_property(
        select(func.coalesce(Recycled.slug, Map.slug))
        .select_from(Map)
        .outerjoin(Recycled, Recycled.id == Map.id)
        .where(Map.id == map_id)
        .correlate_except(Map, Recycled)
        .scalar_subquery(),
        expire_on_flush=False,  # a job changes no name
    )

    @property
    def ended(self) -> bool:
        """Whether it is done, failed or cancelled."""
        return self.state not in OPEN_STATES

    def remaining_s(self, now: datetime) -> float | None:
        """Return the time left of its stage at the rate so far; `None` if it is not known."""
        if self.state != JobState.RUNNING or self.stage_started_at is None or not self.done_units:
            return None
        spent_s = (now - self.stage_started_at).total_seconds()
        return max(0.0, spent_s * (self.total_units / self.done_units - 1.0))


class Capture(Base):
    """A capture or bag that is uploaded in parts, to become scans of a drive.

    Attributes:
        drive: Slug of the drive; it may not exist yet.
        files: Name and size in bytes of each file, in the order in which they are sent.
        part_bytes: Size of every part but the last.
        topic: The topic of the scans in a bag, where several have point clouds.
        first_scan: Index in the drive of the first scan.
        digest: SHA-256 of all files together, if the client gave it.
        key_id: Id of the key that uploads it; not a foreign key: the operator's is in no table.
        touched_at: When it was made, its last part came, or it was queued.
        job_id: The last job that reads it, `None` before it is complete; not a foreign key.
    """

    __tablename__ = "captures"
    __table_args__ = (
        Index(None, "map_id", "created_at", "id"),
        Index(None, "map_id", "drive", "created_at", "id"),
    )

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    map_id: Mapped[str] = mapped_column(Id, ForeignKey("maps.id", ondelete="CASCADE"))
    drive: Mapped[str] = mapped_column(Slug)
    files: Mapped[list[list[Any]]] = mapped_column(JSON)
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    part_bytes: Mapped[int]
    topic: Mapped[str | None] = mapped_column(PlainString(255))
    first_scan: Mapped[int] = mapped_column(BigInteger)
    digest: Mapped[str | None] = mapped_column(Digest)
    key_id: Mapped[str | None] = mapped_column(Id)
    created_at: Mapped[datetime]
    touched_at: Mapped[datetime]
    job_id: Mapped[str | None] = mapped_column(Id, default=None)


class CapturePart(Base):
    """A part of a capture that was received, and the file that holds it."""

    __tablename__ = "capture_parts"

    capture_id: Mapped[str] = mapped_column(
        Id, ForeignKey("captures.id", ondelete="CASCADE"), primary_key=True
    )
    number: Mapped[int] = mapped_column(primary_key=True)
    digest: Mapped[str] = mapped_column(Digest)
    file_name: Mapped[str] = mapped_column(PlainString(100))
