"""What the catalog returns where one row does not have it all, and what it is given."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Any, Generic, TypeVar

from core.mapping.anchor import Anchor
from core.scans.mounting import Mounting
from core.scans.pose import Pose, PoseSource
from storage.catalog.models import JobRecord, JobState
from storage.files.drive_chunks import BYTES_PER_RETURN
from storage.index_ranges import IndexRange
from storage.retention import OwnRetention

T = TypeVar("T")


@dataclass(frozen=True)
class Page(Generic[T]):
    """A part of a list.

    Attributes:
        items: The items in the list's order.
        next_after: The cursor of the next page, `None` at the end.
    """

    items: tuple[T, ...]
    next_after: str | None


@dataclass(frozen=True)
class MapRecord:
    """A map: the named container of drives and revisions.

    Attributes:
        version: Counts the changes of this record, including the live revision; for ETags.
        live_revision: Digest of the revision that scan queries use, `None` before the first.
        retention: What it keeps, where that is not the service's default.
        anchor: The map's place on the Earth, `None` if that is not set.
    """

    id: str
    slug: str
    description: str
    created_at: datetime
    version: int
    live_revision: str | None
    retention: OwnRetention
    anchor: Anchor | None = None


@dataclass(frozen=True)
class DriveRecord:
    """A drive.

    Attributes:
        mounting: The mounting of its sensor, `None` if the vehicle's frame is the sensor's.
        accumulate: How many consecutive scans become one of a map.
        odometry: How its poses were computed, in plain values; `None` if they were given.
        pose_check: How given poses agree with the scans, in plain values; `None` if not checked.
    """

    id: str
    map_id: str
    slug: str
    created_at: datetime
    closed: bool
    mounting: Mounting | None = None
    accumulate: int = 1
    odometry: Mapping[str, Any] | None = None
    pose_check: Mapping[str, Any] | None = None

    @property
    def pose_source(self) -> PoseSource:
        """Where its poses come from."""
        return PoseSource.GIVEN if self.odometry is None else PoseSource.ODOMETRY


@dataclass(frozen=True, kw_only=True)
class FilledDrive(DriveRecord):
    """A drive, and how many scans and poses it has.

    Attributes:
        scans: Number of its scans.
        expected_poses: Number of poses of scans that are not stored yet.
    """

    scans: int
    expected_poses: int = 0

    @property
    def poses_waiting(self) -> int:
        """Number of these whose scans may still come."""
        return 0 if self.closed else self.expected_poses

    @property
    def poses_left_over(self) -> int:
        """Number of these whose scans never come, as the drive is closed."""
        return self.expected_poses if self.closed else 0


@dataclass(frozen=True, kw_only=True)
class CountedDrive(FilledDrive):
    """A drive, and what its scans have.

    Attributes:
        returns: Number of the returns of its scans.
        scans_without_returns: Number of scans whose returns were dropped after a build.
        kept_returns: Number of returns that are stored: those of the other scans.
        present: The indices of its scans, as ranges in ascending order.
        scans_with_pose: Number of scans with a pose.
    """

    returns: int
    scans_without_returns: int
    kept_returns: int
    present: tuple[IndexRange, ...]
    scans_with_pose: int

    @property
    def gaps(self) -> tuple[IndexRange, ...]:
        """The indices that are missing between the first and the last."""
        pairs = zip(self.present, self.present[1:], strict=False)
        return tuple(IndexRange(left.last + 1, right.first - 1) for left, right in pairs)

    @property
    def size_bytes(self) -> int:
        """Size of the stored returns; each chunk file adds some 5 KB."""
        return self.kept_returns * BYTES_PER_RETURN


@dataclass(frozen=True)
class PosesPut:
    """Counts of poses that were put.

    Attributes:
        set: Scans that have one of these poses now.
        replaced: How many of these scans had another pose before.
        forgotten: Scans that had a pose and have none now.
        waiting: Poses that are kept for scans that are not stored yet.
        left_over: Poses of scans that a closed drive lacks; they are not kept.
    """

    set: int
    replaced: int
    forgotten: int
    waiting: int = 0
    left_over: int = 0


@dataclass(frozen=True)
class ScanRecord:
    """A stored scan: where its returns are, and the facts about them.

    Attributes:
        index: The scan's index in the drive.
        chunk: Name of its chunk file; a closed drive's scans move into bigger ones. Empty once
            its returns were dropped.
        row: The scan's row in that file.
        digest: SHA-256 of its returns, see `storage.files.drive_chunks.scan_digest`.
        timestamp_s: Seconds, NaN where unknown.
    """

    index: int
    chunk: str
    row: int
    digest: str
    returns: int
    dropped_returns: int
    timestamp_s: float = field(hash=False)
    pose: Pose | None

    def __eq__(self, other: object) -> bool:
        """Compare facts: two times that are unknown are alike, although NaN is no number."""
        return isinstance(other, ScanRecord) and self._facts() == other._facts()

    def _facts(self) -> dict[str, Any]:
        unknown = math.isnan(self.timestamp_s)
        return {**vars(self), "timestamp_s": None if unknown else self.timestamp_s}

    @property
    def has_returns(self) -> bool:
        """Whether its returns are stored; they may be dropped after a build."""
        return bool(self.chunk)


class CaptureState(StrEnum):
    """State of an uploaded capture: before its job, and then that of its job."""

    RECEIVING = "receiving"
    QUEUED = JobState.QUEUED.value
    RUNNING = JobState.RUNNING.value
    DONE = JobState.DONE.value
    FAILED = JobState.FAILED.value
    CANCELLED = JobState.CANCELLED.value


@dataclass(frozen=True)
class NewCapture:
    """What is announced of a capture before its parts are sent."""

    drive: str
    """Slug of the drive; it is made with the first scan."""
    files: tuple[tuple[str, int], ...]
    """Name and size in bytes of each file."""
    part_bytes: int
    """Size of every part but the last."""
    topic: str | None = None
    """Topic of the scans in a bag."""
    first_scan: int = 0
    """Index in the drive of the first scan."""
    digest: str | None = None
    """SHA-256 of all files together."""
    key_id: str | None = None
    """Id of the key that uploads it."""

    @property
    def size_bytes(self) -> int:
        """Size of all files together."""
        return sum(size for _, size in self.files)


@dataclass(frozen=True)
class CaptureSummary:
    """A capture or bag that is uploaded in parts, as in a list.

    Attributes:
        drive: Slug of the drive that its scans are for.
        files: Name and size in bytes of each file, in the order in which they are sent.
        part_bytes: Size of every part but the last.
        topic: The topic of the scans in a bag, where several have point clouds.
        first_scan: Index in the drive of the first scan.
        digest: SHA-256 of all files together, if the client gave it.
        touched_at: When it was made, its last part came, or it was queued.
        parts_received: The number of parts that are stored.
        job: The last job that reads it, `None` before it is complete.
    """

    id: str
    map_id: str
    drive: str
    files: tuple[tuple[str, int], ...]
    size_bytes: int
    part_bytes: int
    topic: str | None
    first_scan: int
    digest: str | None
    created_at: datetime
    touched_at: datetime
    parts_received: int
    job: JobRecord | None

    @property
    def state(self) -> CaptureState:
        """Its state."""
        return CaptureState.RECEIVING if self.job is None else CaptureState(self.job.state.value)

    @property
    def takes_parts(self) -> bool:
        """Whether parts of it can be stored."""
        return self.state not in {CaptureState.QUEUED, CaptureState.RUNNING, CaptureState.DONE}

    @property
    def idle_since(self) -> datetime | None:
        """Since when nothing is done with it, `None` while its job waits or runs.

        By this it expires: `ended_captures.clear_expired` asks the database for the same.
        """
        if self.job is None:
            return self.touched_at
        ended_at = self.job.finished_at
        return None if ended_at is None else max(self.touched_at, ended_at)

    @property
    def parts(self) -> int:
        """The number of its parts, counted from 0."""
        return -(-self.size_bytes // self.part_bytes)

    def size_of(self, number: int) -> int | None:
        """Return the size of a part in bytes, `None` if there is no part of this number."""
        if not 0 <= number < self.parts:
            return None
        return min(self.part_bytes, self.size_bytes - number * self.part_bytes)


@dataclass(frozen=True)
class CaptureRecord(CaptureSummary):
    """A capture or bag that is uploaded in parts.

    Attributes:
        received: Numbers of the parts that are stored, as ranges in ascending order.
    """

    received: tuple[IndexRange, ...]

    @property
    def missing(self) -> tuple[IndexRange, ...]:
        """The numbers of the parts that are not stored."""
        if self.state == CaptureState.DONE:  # they were stored, and are no longer needed
            return ()
        ends = [-1, *(part for run in self.received for part in (run.first, run.last)), self.parts]
        pairs = zip(ends[::2], ends[1::2], strict=True)
        return tuple(IndexRange(left + 1, right - 1) for left, right in pairs if right > left + 1)


@dataclass(frozen=True)
class RevisionFacts:
    """What the builder of a revision knows about it.

    Attributes:
        bases: Digests of the bases whose signatures it accepts.
        notes: Remarks of the job that built it.
        drive_ids: Ids of the drives that it was built of, by slug; none if it is imported.
        job_result: What the job that built it decided, in plain values.
    """

    encoding: str
    scans: int
    segments: int
    parameters: Mapping[str, Any]
    job_id: str | None = None
    bases: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    drive_ids: Mapping[str, str] = field(default_factory=dict)
    job_result: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class IdempotencyKey:
    """What identifies a request among those of one access key for the same map.

    Attributes:
        name: The name that the client gave, up to 255 characters.
        digest: SHA-256 of what is requested, 64 hexadecimal digits.
    """

    name: str
    digest: str
