"""Poses over the wire."""

import math
from collections import Counter
from typing import Annotated

import numpy as np
from fastapi import Query
from pydantic import BaseModel, ConfigDict, Field, field_validator

from app.http.exact_types import Number, integers
from app.http.shown import Shown
from core.errors import InvalidPose
from core.scans.pose import Pose, is_known
from storage.catalog import DriveRecord, ScanPoses

_ORDER = "x,y,z,qx,qy,qz,qw: metres and a unit quaternion, sensor to world"

PoseQuery = Annotated[
    str | None,
    Query(description=f"Where the scan was taken, {_ORDER}.", examples=["1.5,-2,1.73,0,0,0,1"]),
]


class PoseOut(Shown):
    """Where a scan of the map was taken: sensor, or the vehicle of a mounted one, to world."""

    x_m: float
    y_m: float
    z_m: float
    qx: float
    qy: float
    qz: float
    qw: float
    yaw_deg: float = Field(description="Heading of its x axis, counter-clockwise.")

    @classmethod
    def from_core(cls, pose: Pose) -> "PoseOut":
        """Show a pose."""
        return cls.of(pose)


class ScanPoseIn(BaseModel):
    """Where and when one scan of a drive was taken."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    scan: int = Field(ge=0, lt=2**53, description="Its index in the drive.")
    pose: Annotated[list[Number], Field(min_length=7, max_length=7, fail_fast=True)] | None = Field(
        None, description=f"{_ORDER}; null removes it, without it nothing changes."
    )
    timestamp_s: Number | None = Field(None, description="Seconds; without it nothing changes.")

    _integers = field_validator("scan", mode="before")(integers)


class PosesIn(BaseModel):
    """Where and when scans of a drive were taken."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {"poses": [{"scan": 0, "pose": [1.5, -2.0, 1.73, 0.0, 0.0, 0.0, 1.0]}]}
        },
    )

    poses: list[ScanPoseIn] = Field(min_length=1, max_length=10_000, fail_fast=True)

    def to_core(self) -> tuple[dict[int, Pose | None], dict[int, float]]:
        """Return poses and timestamps by scan index.

        Raises:
            InvalidPose: If a scan comes twice or a quaternion is not of length 1.
        """
        twice = [scan for scan, count in Counter(i.scan for i in self.poses).items() if count > 1]
        if twice:
            raise InvalidPose(f"scan {twice[0]} comes twice")
        poses = {
            item.scan: None if item.pose is None else Pose(*item.pose)
            for item in self.poses
            if "pose" in item.model_fields_set
        }
        times = {i.scan: i.timestamp_s for i in self.poses if i.timestamp_s is not None}
        return poses, times


class ScanPoseOut(BaseModel):
    """Where and when one scan of a drive was taken."""

    scan: int = Field(description="Its index in the drive.")
    pose: list[float] | None = Field(description=f"{_ORDER}; null where unknown.")
    timestamp_s: float | None = Field(description="Seconds; null where unknown.")


class PosesOut(Shown):
    """Where and when scans of a drive were taken."""

    drive: str
    scans: int = Field(description="Of the drive.")
    scans_with_pose: int
    poses_waiting: int = Field(description="Poses of scans that are not stored yet.")
    poses: list[ScanPoseOut]
    next_first: int | None = Field(description="`first` of the next scans; null at the end.")

    @classmethod
    def from_core(cls, drive: DriveRecord, found: ScanPoses, limit: int) -> "PosesOut":
        """Show the first scans of those that were found; there may be one more."""
        posed, timed = is_known(found.poses), np.isfinite(found.timestamps_s)
        columns = (found.scans, posed, found.poses, timed, found.timestamps_s)
        rows = zip(*(column[:limit].tolist() for column in columns), strict=True)
        return cls.of(
            drive,
            drive=drive.slug,
            scans_with_pose=drive.posed_scans,
            poses_waiting=0 if drive.closed else drive.expected_poses,
            poses=[
                ScanPoseOut(
                    scan=scan,
                    pose=pose if has_pose else None,
                    timestamp_s=timestamp_s if has_time else None,
                )
                for scan, has_pose, pose, has_time, timestamp_s in rows
            ],
            next_first=int(found.scans[limit]) if len(found) > limit else None,
        )


def pose_from_query(text: str | None) -> Pose | None:
    """Read `x,y,z,qx,qy,qz,qw`.

    Raises:
        InvalidPose: If it is not seven numbers with a unit quaternion.
    """
    if text is None:
        return None
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 7 or not all(math.isfinite(value) for value in values):
        raise InvalidPose(f"pose is {text[:120]!r}, wanted {_ORDER}")
    return Pose(*values)
