"""Drives, their scans and uploads over the wire."""

from collections.abc import Iterable
from datetime import datetime
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from app.drives.mounting_schemas import MountingIn, MountingOut
from app.http.exact_types import integers, truth_values
from app.http.problems import SetAsideOut
from app.http.shown import Shown
from core.numbers import none_if_nan
from core.scans.accumulation import MOST_SCANS
from core.scans.pose import PoseSource
from core.scans.scan import Scan
from storage.catalog import CountedDrive, ScanRecord
from storage.index_ranges import index_ranges

MOST_JUMPS = 1000
"""Listed in an answer."""


class IndexRangeOut(Shown):
    """Scan indices `first` to `last`, both included."""

    first: int
    last: int

    @classmethod
    def all_of(cls, indices: Iterable[int]) -> "list[IndexRangeOut]":
        """Return the ranges that indices make, in rising order."""
        return list(map(cls.of, index_ranges(indices)))


class DriveOut(Shown):
    """A recording of scans."""

    drive: str
    created_at: datetime
    closed: bool = Field(description="A closed drive takes no new scans.")
    scans: int
    returns: int = Field(description="Number of returns of all scans.")
    size_bytes: int = Field(description="What the returns that are kept take on disk.")
    scans_without_returns: int = Field(
        description="Scans whose returns were dropped after a build by the map's retention. They"
        " stay listed, and are recognized if sent again; builds use the images that were kept."
    )
    scans_with_pose: int
    pose_source: PoseSource = Field(
        description="`given`, or `odometry`: a build computed them from the scans, in a frame that"
        " begins with the first one. Poses that are put take their place."
    )
    poses_waiting: int = Field(description="Poses of scans that are not stored yet.")
    poses_left_over: int = Field(
        description="Poses of scans that the closed drive does not have: another drive's?"
    )
    present: list[IndexRangeOut] = Field(description="The indices that are stored.")
    gaps: list[IndexRangeOut] = Field(description="The indices that are missing in between.")
    mounting: MountingOut | None = Field(
        description="Mounting of its sensor; null if the vehicle's frame is the sensor's."
    )
    accumulate: int = Field(description="How many consecutive scans become one of a map.")

    @classmethod
    def from_record(cls, record: CountedDrive) -> "DriveOut":
        """Show a drive's record."""
        return cls.of(record, drive=record.slug)


class PosesPutOut(Shown):
    """What poses that were put changed."""

    set: int = Field(description="How many scans have one of these poses.")
    replaced: int = Field(description="How many of these scans had another pose before.")
    forgotten: int = Field(
        description="How many scans had a pose and have none now, also a computed one."
    )
    waiting: int = Field(description="How many poses are of scans that are not stored yet.")
    left_over: int = Field(
        description="How many poses are of scans that the closed drive does not have; they are not"
        " kept."
    )


class DriveWithPosesOut(DriveOut):
    """A drive, and what poses that were put changed."""

    poses: PosesPutOut
    jumps: list[int] = Field(
        description="Scans that are now farther from the one before than a vehicle moves, among"
        " those that were put and ten beside them; the first thousand."
    )


class DriveIn(BaseModel):
    """How builds read a drive."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {"mounting": {"x_m": 1.2, "y_m": 0.0, "z_m": 1.9, "pitch_deg": 5.0}},
                {"accumulate": 5},
            ],
        },
    )

    mounting: MountingIn | None = Field(
        None,
        description="Mounting of its sensor: the map's poses, and answers, are then the vehicle's."
        " The poses of the drive's scans stay the sensor's.",
    )
    accumulate: int = Field(
        1,
        ge=1,
        le=MOST_SCANS,
        description="How many consecutive scans become one of a map, in the frame of the last; they"
        " need poses. For sensors with few returns a scan.",
    )

    _integers = field_validator("accumulate", mode="before")(integers)


class DrivePatch(BaseModel):
    """Changes of a drive."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"closed": True}})

    closed: Literal[True] = Field(description="A closed drive stays closed.")

    _truth_values = field_validator("closed", mode="before")(truth_values)


class ScanOut(Shown):
    """A stored scan, without its returns."""

    scan: int = Field(description="The scan's index in the drive.")
    returns: int
    dropped_returns: int = Field(description="Returns that were not finite or zero, left out.")
    digest: str = Field(description="SHA-256 of the returns as little-endian float32.")
    timestamp_s: float | None
    has_pose: bool
    returns_kept: bool = Field(
        description="False once its returns were dropped after a build; the digest stays."
    )
    notes: list[str] = Field(
        description="Notes for the client: that the scan was stored before, and keeps another time"
        " or pose than came with it."
    )

    @classmethod
    def of_put(cls, put: Scan, record: ScanRecord) -> "ScanOut":
        """Show what is stored of a scan that was put."""
        return cls.of(
            record,
            scan=record.index,
            timestamp_s=none_if_nan(record.timestamp_s),
            has_pose=record.pose is not None,
            returns_kept=record.has_returns,
            notes=_of_another(put, record),
        )


def _of_another(put: Scan, record: ScanRecord) -> list[str]:
    """Say which of a scan's time and pose came otherwise than they are stored."""
    kept = {
        "timestamp_s": (none_if_nan(put.timestamp_s), none_if_nan(record.timestamp_s)),
        "pose": (put.pose, record.pose),
    }
    return [
        f"{name} was not taken: the scan was stored before with another one or none, which is kept;"
        " PUT .../poses changes it"
        for name, (came, stored) in kept.items()
        if came is not None and came != stored
    ]


class PresentOut(Shown):
    """Which scans of a drive are stored, so that an interrupted upload can be continued."""

    drive: str
    closed: bool = Field(description="A closed drive takes no new scans.")
    scans: int
    scans_without_returns: int = Field(
        description="Those whose returns were dropped after a build; they need not be sent again."
    )
    scans_with_pose: int
    present: list[IndexRangeOut] = Field(description="The indices that are stored.")
    gaps: list[IndexRangeOut] = Field(description="The indices that are missing in between.")


class UploadOut(BaseModel):
    """The result for the files of an upload; what is stored is on disk."""

    scans_stored: int
    scans_present: int
    files_set_aside: int
    stored: list[IndexRangeOut] = Field(description="Indices that are new.")
    present: list[IndexRangeOut] = Field(
        description="Indices whose scan was stored before, the same."
    )
    set_aside: list[SetAsideOut] = Field(
        description="Files that were not stored, with the reason; the first thousand."
    )
    poses: PosesPutOut | None = Field(
        description="What a `poses.txt` in the archive changed; null without one that fits."
    )
    notes: list[str] = Field(
        description="Notes for the client: that the archive may be cut off, or its scans are in"
        " several folders, as those of several drives."
    )
