"""What the catalog returns where one row does not have it all, and what it is given."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Generic, TypeVar

from core.scans.mounting import Mounting
from core.scans.pose import Pose
from storage.retention import OwnRetention

T = TypeVar("T")

BYTES_PER_RETURN = 12  # three float32


@dataclass(frozen=True)
class Page(Generic[T]):
    """A part of a list.

    Attributes:
        items: In the list's order.
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
    """

    id: str
    slug: str
    description: str
    created_at: datetime
    version: int
    live_revision: str | None
    retention: OwnRetention


@dataclass(frozen=True)
class IndexRange:
    """Scan indices `first` to `last`, both included."""

    first: int
    last: int


@dataclass(frozen=True)
class DriveRecord:
    """A drive.

    Attributes:
        scans: Number of its scans.
        returns: Number of their returns.
        dropped_scans: Number of scans whose returns were dropped after a build.
        kept_returns: Number of returns that are stored: those of the other scans.
        present: The indices of its scans, as ranges in ascending order.
        posed_scans: Number of scans with a pose.
        expected_poses: Number of poses of scans that are not stored yet.
        mounting: Of its sensor, `None` if the vehicle's frame is the sensor's.
        accumulate: How many consecutive scans become one of a map.
    """

    id: str
    map_id: str
    slug: str
    created_at: datetime
    closed: bool
    scans: int
    returns: int
    dropped_scans: int
    kept_returns: int
    present: tuple[IndexRange, ...]
    posed_scans: int = 0
    expected_poses: int = 0
    mounting: Mounting | None = None
    accumulate: int = 1

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
        replaced: Of these, scans that had another pose before.
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
        index: Its index in the drive.
        chunk: Name of its chunk file; a closed drive's scans move into bigger ones. Empty once
            its returns were dropped.
        row: Its row there.
        digest: SHA-256 of its returns, see `storage.files.drive_chunks.scan_digest`.
        timestamp_s: Seconds, NaN where unknown.
    """

    index: int
    chunk: str
    row: int
    digest: str
    returns: int
    dropped_returns: int
    timestamp_s: float
    pose: Pose | None

    @property
    def has_returns(self) -> bool:
        """Whether its returns are stored; they may be dropped after a build."""
        return bool(self.chunk)


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
class RequestKey:
    """What identifies a request among those of the same map.

    Attributes:
        key: The client's idempotency key, up to 255 characters.
        digest: SHA-256 of what is requested, 64 hexadecimal digits.
    """

    key: str
    digest: str
