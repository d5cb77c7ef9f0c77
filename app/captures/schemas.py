"""Captures in parts over the wire."""

import re
from datetime import datetime, timedelta
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator

from app.drives.schemas import IndexRangeOut
from app.http.bodies.bodies import LARGEST_PART_BYTES
from app.http.exact_types import Name, integers, truth_values
from app.http.job_error import JobErrorOut
from app.http.shown import Shown
from storage.catalog import CaptureState, CaptureSummary, JobState
from storage.store.put_scans import MOST_SCANS

MOST_FILES = 1000
SMALLEST_PART_BYTES = 64 * 2**10
_MOST_NAME_BYTES = 255  # of a file's name on disk
_NEVER_IN_NAMES = re.compile(r"[/\x00-\x1f\x7f]")

Topic = Annotated[Name, Field(min_length=1, max_length=255)]


class CaptureFile(BaseModel):
    """A file of a capture."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(
        min_length=1,
        max_length=_MOST_NAME_BYTES,
        description="With its suffix, without a folder: without `/` and control characters, and"
        f" with no dot at its beginning; at most {_MOST_NAME_BYTES} bytes of UTF-8.",
    )
    size_bytes: int = Field(ge=1, lt=2**53)

    _integers = field_validator("size_bytes", mode="before")(integers)

    @field_validator("name")
    @classmethod
    def _of_a_file(cls, name: str) -> str:
        if name.startswith(".") or _NEVER_IN_NAMES.search(name):
            raise ValueError(
                "wanted a file's name without a folder: no /, no control character, no dot at its"
                " beginning"
            )
        if len(name.encode()) > _MOST_NAME_BYTES:
            raise ValueError(f"wanted at most {_MOST_NAME_BYTES} bytes of UTF-8")
        return name


class CaptureIn(BaseModel):
    """A capture or bag to upload in parts."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {
                "files": [{"name": "monday.mcap", "size_bytes": 52428800}],
                "topic": "/velodyne_points",
            }
        },
    )

    files: list[CaptureFile] = Field(
        min_length=1,
        max_length=MOST_FILES,
        description="One `.pcap`, `.bag`, `.mcap` or `.db3`; or those of a folder that ROS 2"
        " recorded, with its `metadata.yaml`. They are sent one after another, in this order, as"
        " one sequence of bytes.",
    )
    topic: Topic | None = Field(
        None, description="Topic of the scans in a bag; not needed where only one has point clouds."
    )
    first_scan: int = Field(
        0,
        ge=0,
        lt=MOST_SCANS,
        description="Index in the drive of the first scan; the others follow it.",
    )
    sha256: str | None = Field(
        None,
        pattern="^[0-9a-f]{64}$",
        description="SHA-256 of all files together. With it a repeated request returns the capture"
        " that is there, with another topic only while it takes parts; and other bytes are rejected"
        " at the end.",
    )
    part_bytes: int | None = Field(
        None,
        ge=SMALLEST_PART_BYTES,
        le=LARGEST_PART_BYTES,
        description="Size of every part but the last; by default a two-hundredth of the capture,"
        " within these limits and those of the service.",
    )

    _integers = field_validator("first_scan", "part_bytes", mode="before")(integers)


class CapturePatch(BaseModel):
    """The end of an upload."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"complete": True}})

    complete: Literal[True] = Field(description="True to have it read: all its parts were sent.")
    topic: Topic | None = Field(
        None, description="Topic of the scans, in place of the one that was given before."
    )

    _truth_values = field_validator("complete", mode="before")(truth_values)


class CaptureScansOut(BaseModel):
    """What the scans of a capture became."""

    scans: int = Field(description="Number of its scans.")
    stored: int = Field(description="Number of its scans that are new.")
    present: int = Field(description="Number of its scans that were stored before, the same.")
    skipped: int = Field(
        description="Number of its scans that cannot be used; the job's notes have reasons."
    )


class CaptureSummaryOut(Shown):
    """An upload of a capture or bag in parts, as in a list."""

    capture: str = Field(description="The capture's id.")
    drive: str
    state: CaptureState = Field(
        description="`receiving` before it was completed, then the state of its job. A failed or"
        " cancelled one keeps its parts, and can be completed again."
    )
    files: list[CaptureFile]
    size_bytes: int = Field(description="Size of all files together.")
    part_bytes: int = Field(description="Size of every part but the last, which has the rest.")
    parts: int = Field(description="Number of parts; they are numbered from 0.")
    parts_received: int = Field(description="Number of stored parts; 0 once it was read.")
    topic: str | None
    first_scan: int
    sha256: str | None
    job: str | None = Field(description="The last job that reads it: follow it under `/v1/jobs`.")
    scans: CaptureScansOut | None = Field(
        description="What its scans became; null before it was read."
    )
    error: JobErrorOut | None = Field(description="Why it could not be read.")
    created_at: datetime
    expires_at: datetime | None = Field(
        description="When the capture is deleted if no part comes before, or it is not read; null"
        " while it is read."
    )

    @classmethod
    def from_record(cls, record: CaptureSummary, kept_hours: float) -> Self:
        """Show a capture's record."""
        job = record.job
        scans = None
        if job is not None and job.state == JobState.DONE:
            scans = CaptureScansOut(**job.result)
        idle_since = record.idle_since
        return cls.of(
            record,
            capture=record.id,
            files=[_file(name, size) for name, size in record.files],
            sha256=record.digest,
            job=None if job is None else job.id,
            scans=scans,
            error=None if job is None else JobErrorOut.from_record(job),
            expires_at=None if idle_since is None else idle_since + timedelta(hours=kept_hours),
        )


class CaptureOut(CaptureSummaryOut):
    """An upload of a capture or bag in parts."""

    received: list[IndexRangeOut] = Field(
        description="Numbers of the parts that are stored; none once it was read."
    )
    missing: list[IndexRangeOut] = Field(description="Numbers of the parts to send.")


def _file(name: str, size_bytes: int) -> dict[str, Any]:
    return {"name": name, "size_bytes": size_bytes}
