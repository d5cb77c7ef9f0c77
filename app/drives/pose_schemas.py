"""Poses over the wire."""

from collections import Counter
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, Strict, field_validator

from app.http.exact_types import Number, Seconds, integers
from app.http.shown import Shown, is_none
from core.errors import InvalidPose
from core.scans.pose import Pose, PoseSource, is_known
from core.scans.pose_steps import jumps
from core.scans.trajectory import SCAN_INDEX_LIMIT

if TYPE_CHECKING:  # commands show poses too, and have no catalog to import
    from storage.catalog import CountedDrive, ScanPoses

POSE_ORDER = "x,y,z,qx,qy,qz,qw: metres and a unit quaternion, sensor to world"


class Wgs84Out(BaseModel):
    """A place on the Earth."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = Field(description="Altitude above the ellipsoid.")
    bearing_deg: float = Field(description="Heading, clockwise from true north, 0..360.")


class PoseOut(Shown):
    """A pose in the map's frame: of the sensor, or of the vehicle if the sensor has a mounting."""

    x_m: float
    y_m: float
    z_m: float
    qx: float
    qy: float
    qz: float
    qw: float
    yaw_deg: float = Field(description="Heading of its x axis, counter-clockwise.")
    wgs84: Wgs84Out | None = Field(
        None,
        exclude_if=is_none,
        description="The pose on the Earth, if the map has an anchor and the drive a place in it.",
    )


class ScanPoseIn(BaseModel):
    """Where and when one scan of a drive was taken."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    scan: int = Field(ge=0, lt=SCAN_INDEX_LIMIT, description="The scan's index in the drive.")
    pose: Annotated[list[Number], Field(min_length=7, max_length=7, fail_fast=True)] | None = Field(
        None, description=f"{POSE_ORDER}; null removes it, without it nothing changes."
    )
    timestamp_s: Annotated[Seconds, Strict()] | None = Field(
        None, description="Time in seconds; without it nothing changes."
    )

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

    scan: int = Field(description="The scan's index in the drive.")
    pose: list[float] | None = Field(description=f"{POSE_ORDER}; null where unknown.")
    timestamp_s: float | None = Field(description="Time in seconds; null where unknown.")


class ScanSigmaOut(BaseModel):
    """How far a pose by odometry may be trusted: standard deviations against the first scan's."""

    scan: int = Field(description="The scan's index in the drive.")
    sigma_m: float = Field(description="Standard deviation of x and of y.")
    sigma_deg: float = Field(description="Standard deviation of the heading.")


class MotionOut(BaseModel):
    """How the sensor moved from one scan to another, in the level frame of the first."""

    forward_m: float
    left_m: float
    up_m: float
    turn_deg: float = Field(description="Angle of the rotation, whatever its axis.")


class ContradictionOut(BaseModel):
    """Two scans between which the sensor moved otherwise than the poses say."""

    first: int = Field(description="Index of the one scan.")
    last: int = Field(description="Index of the other scan.")
    by_poses: MotionOut
    by_scans: MotionOut


class PoseCheckOut(BaseModel):
    """Given poses beside the motion that the scans show, of up to eight pairs of scans."""

    agreeing: int = Field(description="Pairs between which the sensor moved as the poses say.")
    contradictions: list[ContradictionOut]
    still: int = Field(description="Pairs between which it did not move.")
    unmeasured: int = Field(
        description="Pairs too far apart, or in surroundings that do not show the motion."
    )
    scale: float | None = Field(
        None,
        description="How many times as far as the scans the poses say that the sensor moved; null"
        " if that is once, or not known.",
    )
    in_map_frame: bool = Field(
        default=False,
        description="Whether the returns are in the frame of the poses, and not in the sensor's;"
        " then no pair is compared.",
    )
    turned_deg: float | None = Field(
        None,
        description="How far to the left of the way by the scans the poses go; null if they go the"
        " same way to some 8 degrees, or that is not known.",
    )


class PosesOut(Shown):
    """Where and when scans of a drive were taken."""

    drive: str
    scans: int = Field(description="Number of scans of the drive.")
    scans_with_pose: int
    pose_source: PoseSource = Field(description="`given`, or by a build's `odometry`.")
    odometry: dict[str, Any] | None = Field(
        description="How odometry computed them: versions, parameters, closures; null if given."
    )
    pose_check: PoseCheckOut | None = Field(
        description="Given poses as the last build checked them; null before, and if computed."
    )
    poses_waiting: int = Field(description="Poses of scans that are not stored yet.")
    poses: list[ScanPoseOut]
    sigmas: list[ScanSigmaOut] = Field(
        description="Standard deviations of those of `poses` that are by odometry."
    )
    jumps: list[int] = Field(
        description="Those of `poses` that are farther from the one before than a vehicle moves."
    )
    next_first: int | None = Field(description="`first` of the next scans; null at the end.")

    @classmethod
    def from_core(cls, drive: "CountedDrive", found: "ScanPoses", limit: int) -> "PosesOut":
        """Show the first scans of those that were found; there may be one more."""
        posed, timed = is_known(found.poses), np.isfinite(found.timestamps_s)
        columns = (found.scans, posed, found.poses, timed, found.timestamps_s)
        rows = zip(*(column[:limit].tolist() for column in columns), strict=True)
        shown = found.only(np.arange(len(found)) < limit)
        computed = shown.only(np.isfinite(shown.sigmas[:, 0]))
        return cls.of(
            drive,
            drive=drive.slug,
            poses=[
                ScanPoseOut(
                    scan=scan,
                    pose=pose if has_pose else None,
                    timestamp_s=timestamp_s if has_time else None,
                )
                for scan, has_pose, pose, has_time, timestamp_s in rows
            ],
            sigmas=[
                ScanSigmaOut(scan=scan, sigma_m=sigma_m, sigma_deg=sigma_deg)
                for scan, (sigma_m, sigma_deg) in zip(
                    computed.scans.tolist(), computed.sigmas.tolist(), strict=True
                )
            ],
            jumps=jumps(shown.scans, shown.timestamps_s, shown.poses).tolist(),
            next_first=int(found.scans[limit]) if len(found) > limit else None,
        )
