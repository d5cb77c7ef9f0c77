"""What the catalog answers with: frozen facts, free of any session."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from datetime import datetime
from enum import StrEnum
from functools import cache
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from core.scans.pose import Pose
from storage.retention import OwnRetention

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T")

BYTES_PER_RETURN = 12  # three float32


@dataclass(frozen=True)
class Page(Generic[T]):
    """Some of a list.

    Attributes:
        items: In the list's order.
        next_after: The cursor to ask for the rest with, `None` at the end.
    """

    items: tuple[T, ...]
    next_after: str | None


@dataclass(frozen=True)
class MapRecord:
    """A map: the named container of drives and revisions.

    Attributes:
        version: Counts the changes of this record, the live revision's included; for ETags.
        live_revision: Digest of the revision that scan queries use, `None` before the first.
        retention: What it has chosen to keep, where that is not the service's default.
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
        scans: How many scans it has.
        returns: How many returns they have together.
        dropped_scans: Of how many scans the returns were dropped after a build.
        kept_returns: How many returns are stored: those of the other scans.
        present: The indices there are, as ranges in ascending order.
        posed_scans: How many scans have a pose.
        expected_poses: How many poses are kept of scans that are not there.
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

    @property
    def gaps(self) -> tuple[IndexRange, ...]:
        """The indices that are missing between the first and the last."""
        pairs = zip(self.present, self.present[1:], strict=False)
        return tuple(IndexRange(left.last + 1, right.first - 1) for left, right in pairs)

    @property
    def size_bytes(self) -> int:
        """What the returns take; a chunk file adds some 5 KB to its own."""
        return self.kept_returns * BYTES_PER_RETURN


@dataclass(frozen=True)
class PosesPut:
    """What became of poses that were put.

    Attributes:
        set: How many scans have a pose of them.
        replaced: How many of these had another before.
        forgotten: How many scans had a pose and have none now.
        waiting: How many wait for scans to come.
        left_over: How many are of scans that the drive was closed without; they are not kept.
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
        """Whether its returns are stored; they are not once they were dropped after a build."""
        return bool(self.chunk)


@dataclass(frozen=True)
class RevisionFacts:
    """What the builder of a revision knows about it.

    Attributes:
        bases: Digests of the bases that it answers to.
        notes: What the job that built it tells besides.
        drive_ids: Ids of the drives that it was built of, by slug; none if that was elsewhere.
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
class RevisionRecord:
    """One immutable revision of a map.

    Attributes:
        file_name: The HDF5 file that holds it.
        drive_ids: Ids of the drives of this store that it was built of, by slug.
    """

    digest: str
    map_id: str
    file_name: str
    encoding: str
    scans: int
    segments: int
    parameters: Mapping[str, Any]
    size_bytes: int
    job_id: str | None
    created_at: datetime
    drive_ids: Mapping[str, str]


class JobState(StrEnum):
    """Where a job stands; the last three are final."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


@dataclass(frozen=True)
class JobRecord:
    """A long computation and how far it is.

    Attributes:
        stage: What it does now, in a word.
        done_units: Of `total_units`, in this stage.
        error_type: Name of the error it failed with.
        revision: Digest of the revision it built.
        cancel_requested: Someone asked a running job to stop.
        stage_started_at: When this stage began, of a running job that told one.
        notes: What it tells about what it built.
        result: What it decided about it, in plain values.
        key_id: Id of the key that asked for it, `None` where that was not written down.
        plan: What it does, with all that `parameters` leave open chosen when it was queued; `None`
            of a job that an earlier version queued.
    """

    id: str
    map_id: str
    kind: str
    state: JobState
    stage: str
    done_units: int
    total_units: int
    parameters: Mapping[str, Any]
    error_type: str | None
    error_detail: str | None
    revision: str | None
    cancel_requested: bool
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    notes: tuple[str, ...] = ()
    result: Mapping[str, Any] = field(default_factory=dict)
    stage_started_at: datetime | None = None
    key_id: str | None = None
    plan: Mapping[str, Any] | None = None

    @property
    def ended(self) -> bool:
        """Whether it is done, failed or cancelled."""
        return self.state not in {JobState.QUEUED, JobState.RUNNING}

    def remaining_s(self, now: datetime) -> float | None:
        """Return how long its stage will take at the pace so far; `None` if nothing tells."""
        if self.state != JobState.RUNNING or self.stage_started_at is None or not self.done_units:
            return None
        spent_s = (now - self.stage_started_at).total_seconds()
        return max(0.0, spent_s * (self.total_units / self.done_units - 1.0))


@dataclass(frozen=True)
class RequestKey:
    """What tells a request from others of the same map: the client's key and what it asks for.

    Attributes:
        key: Up to 255 characters, the client's choice.
        digest: SHA-256 of what is asked for, 64 hexadecimal digits.
    """

    key: str
    digest: str


@dataclass(frozen=True)
class KeyRecord:
    """An API key; the secret itself is never stored, only its hash.

    Attributes:
        name: What whoever made it calls it.
        secret_hash: SHA-256 of the whole key as it is sent, hex.
        scopes: What it allows.
        maps: Slugs of the maps that it is limited to, `None` for all.
        first_run: The service made it for its administrator.
        expires_at: It opens nothing from then on, `None` for never.
        revoked_at: It opens nothing since then.
    """

    id: str
    name: str
    secret_hash: str
    scopes: tuple[str, ...]
    maps: tuple[str, ...] | None
    first_run: bool
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None

    def opens_at(self, moment: datetime) -> bool:
        """Return whether it opens anything at a moment."""
        return self.revoked_at is None and (self.expires_at is None or moment < self.expires_at)


R = TypeVar("R", bound="DataclassInstance")


@cache
def _names(kind: type["DataclassInstance"]) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))


def record_of(kind: type[R], row: object, **others: object) -> R:
    """Return the record of a row: its columns of the same names, and what `others` says instead."""
    return kind(
        **{name: others[name] if name in others else getattr(row, name) for name in _names(kind)}
    )
