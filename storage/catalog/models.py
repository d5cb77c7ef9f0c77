"""The catalog's tables; every change needs a migration.

A class named `...Record` is also what the catalog returns: its rows are detached from the session.
"""

from datetime import datetime
from enum import StrEnum
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Enum,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    MetaData,
    UniqueConstraint,
)
from sqlalchemy.orm import (
    DeclarativeBase,
    Mapped,
    MappedAsDataclass,
    configure_mappers,
    mapped_column,
)

from storage.catalog.columns import (
    Digest,
    Id,
    JsonOrNull,
    PlainString,
    PlainText,
    Slug,
    UtcDateTime,
    Values,
)


class JobState(StrEnum):
    """State of a job; the last three are final."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


OPEN_STATES = (JobState.QUEUED, JobState.RUNNING)


class Base(MappedAsDataclass, DeclarativeBase):
    """Names every constraint, so that a later migration can drop it on any database."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map = {  # noqa: RUF012  # SQLAlchemy's own declaration
        datetime: UtcDateTime,
        JobState: Enum(
            JobState,
            native_enum=False,
            length=16,
            values_callable=lambda states: [state.value for state in states],
        ),
    }


class StoreId(Base):
    """The data directory that the catalog belongs to: one row, once it belongs to one."""

    __tablename__ = "store"

    row: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    id: Mapped[str] = mapped_column(Id)


class Map(Base):
    """The named container of drives and revisions."""

    __tablename__ = "maps"

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    slug: Mapped[str] = mapped_column(Slug, unique=True)
    description: Mapped[str] = mapped_column(PlainText())
    created_at: Mapped[datetime]
    version: Mapped[int] = mapped_column(default=1)
    # The fields of `storage.retention.OwnRetention` that the map has chosen.
    retention: Mapped[dict[str, Any]] = mapped_column(Values, nullable=True, default_factory=dict)


class Drive(Base):
    """A recording that belongs to a map.

    Attributes:
        mounting: The fields of its `core.scans.mounting.Mounting`, `None` without one.
        accumulate: How many consecutive scans become one of a map.
    """

    __tablename__ = "drives"
    __table_args__ = (UniqueConstraint("map_id", "slug"),)

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    map_id: Mapped[str] = mapped_column(Id, ForeignKey("maps.id", ondelete="CASCADE"))
    slug: Mapped[str] = mapped_column(Slug)
    created_at: Mapped[datetime]
    closed: Mapped[bool] = mapped_column(default=False)
    mounting: Mapped[dict[str, float] | None] = mapped_column(JSON(none_as_null=True), default=None)
    accumulate: Mapped[int] = mapped_column(server_default="1", default=1)


class Scan(Base):
    """One scan of a drive and the location of its returns."""

    __tablename__ = "scans"

    drive_id: Mapped[str] = mapped_column(
        Id, ForeignKey("drives.id", ondelete="CASCADE"), primary_key=True
    )
    index: Mapped[int] = mapped_column("scan_index", BigInteger, primary_key=True)
    chunk: Mapped[str] = mapped_column(PlainString(64))  # empty: its returns were dropped
    row: Mapped[int] = mapped_column("chunk_row")
    digest: Mapped[str] = mapped_column(Digest)
    returns: Mapped[int]
    dropped_returns: Mapped[int]
    timestamp_s: Mapped[float | None]
    pose: Mapped[list[float] | None] = mapped_column(JSON(none_as_null=True))


class ExpectedPose(Base):
    """Pose and time of a scan that is not stored yet; removed when the scan is stored."""

    __tablename__ = "expected_poses"

    drive_id: Mapped[str] = mapped_column(
        Id, ForeignKey("drives.id", ondelete="CASCADE"), primary_key=True
    )
    index: Mapped[int] = mapped_column("scan_index", BigInteger, primary_key=True)
    timestamp_s: Mapped[float | None]
    pose: Mapped[list[float] | None] = mapped_column(JSON(none_as_null=True))


class RevisionRecord(Base):
    """One immutable revision of a map; several maps may have the same digest.

    Attributes:
        file_name: The HDF5 file that holds it.
        job_id: The job that built it; not a foreign key: a revision outlives the list of jobs.
        drive_ids: Ids of the drives of this store that it was built of, by slug; not foreign keys:
            a revision outlives its drives. None for one that was imported.
        retained_from: When it was last built or, if it was live later, replaced; `None` only after
            a downgrade of the schema.
    """

    __tablename__ = "revisions"

    map_id: Mapped[str] = mapped_column(
        Id, ForeignKey("maps.id", ondelete="CASCADE"), primary_key=True
    )
    digest: Mapped[str] = mapped_column(Digest, primary_key=True)
    file_name: Mapped[str] = mapped_column(PlainString(100))
    encoding: Mapped[str] = mapped_column(PlainString(32))
    scans: Mapped[int]
    segments: Mapped[int]
    parameters: Mapped[dict[str, Any]] = mapped_column(JSON)
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    job_id: Mapped[str | None] = mapped_column(Id)
    created_at: Mapped[datetime]
    drive_ids: Mapped[dict[str, str]] = mapped_column(Values, nullable=True, default_factory=dict)
    retained_from: Mapped[datetime | None] = mapped_column(default=None)


class RevisionBasis(Base):
    """A basis that a revision accepts signatures of; many revisions may share one."""

    __tablename__ = "revision_bases"
    __table_args__ = (
        ForeignKeyConstraint(
            ["map_id", "digest"], ["revisions.map_id", "revisions.digest"], ondelete="CASCADE"
        ),
    )

    map_id: Mapped[str] = mapped_column(Id, primary_key=True)
    basis: Mapped[str] = mapped_column(Digest, primary_key=True)
    digest: Mapped[str] = mapped_column(Digest, primary_key=True)


class BasisRecord(Base):
    """A shared basis, which builds of any map can use; named by its digest or by a name."""

    __tablename__ = "bases"

    digest: Mapped[str] = mapped_column(Digest, primary_key=True)
    name: Mapped[str] = mapped_column(Slug, unique=True)
    file_name: Mapped[str] = mapped_column(PlainString(100))
    encoding: Mapped[str] = mapped_column(PlainString(32))
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    created_at: Mapped[datetime]


class LiveRevision(Base):
    """Which revision of a map is live.

    A table, not a column of maps: maps and revisions would refer to each other in a circle, which
    SQLite cannot alter. So the database itself rejects the deletion of a live revision.
    """

    __tablename__ = "live_revisions"
    __table_args__ = (
        ForeignKeyConstraint(["map_id", "digest"], ["revisions.map_id", "revisions.digest"]),
    )

    map_id: Mapped[str] = mapped_column(
        Id, ForeignKey("maps.id", ondelete="CASCADE"), primary_key=True
    )
    digest: Mapped[str] = mapped_column(Digest)


class JobRecord(Base):
    """A long computation for a map, and its progress.

    Attributes:
        stage: What it does now, in a word.
        done_units: Of `total_units`, in this stage.
        plan: What it does, with every default of `parameters` resolved when it was queued; `None`
            for a job that an earlier version queued.
        error_type: Name of the error it failed with.
        revision: Digest of the revision it built; not a foreign key: it outlives the revision.
        cancel_requested: Whether a running job is to stop.
        notes: Remarks on what it built.
        result: What it decided about it, in plain values.
        request_key: Idempotency key of the request that made it; a repeated request returns it.
        key_id: Id of the key that requested it; not a foreign key: the operator's is in no table.
            `None` for a job of an earlier version.
        stage_started_at: Start of this stage, of a running job that reported one.
    """

    __tablename__ = "jobs"
    __table_args__ = (
        Index(None, "created_at", "id"),
        Index(None, "state", "created_at"),
        Index(None, "key_id", "started_at"),
        Index("ix_jobs_request_key", "map_id", "request_key", unique=True),
    )

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    map_id: Mapped[str] = mapped_column(Id, ForeignKey("maps.id", ondelete="CASCADE"), index=True)
    parameters: Mapped[dict[str, Any]] = mapped_column(JSON)
    created_at: Mapped[datetime]
    kind: Mapped[str] = mapped_column(PlainString(32), default="build")
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
    started_at: Mapped[datetime | None] = mapped_column(default=None)
    stage_started_at: Mapped[datetime | None] = mapped_column(default=None)
    finished_at: Mapped[datetime | None] = mapped_column(default=None)

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


class KeyRecord(Base):
    """An API key; the secret itself is never stored, only its hash.

    Attributes:
        name: What its maker calls it.
        secret_hash: SHA-256 of the whole key as it is sent, hex.
        scopes: What it allows.
        maps: Slugs of the maps that it is limited to, `None` for all; not ids: a key may be made
            before its map.
        first_run: Whether the service made it for its administrator.
        expires_at: It is invalid from then on, `None` for never.
        revoked_at: It is invalid since then.
    """

    __tablename__ = "keys"

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    name: Mapped[str] = mapped_column(PlainString(100))
    secret_hash: Mapped[str] = mapped_column(PlainString(255), unique=True)
    scopes: Mapped[list[str]] = mapped_column(JSON)
    maps: Mapped[list[str] | None] = mapped_column(JSON(none_as_null=True))
    first_run: Mapped[bool]
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None] = mapped_column(default=None)

    def opens_at(self, moment: datetime) -> bool:
        """Return whether it is valid at a time."""
        return self.revoked_at is None and (self.expires_at is None or moment < self.expires_at)


class TokenRecord(Base):
    """A token, obtained in exchange for a key; of the secret only the hash is stored.

    Attributes:
        secret_hash: SHA-256 of the token as it is sent, hex.
        key_hash: SHA-256 of the key, whose end is the token's; not a foreign key: the key of the
            settings is in no table.
        scopes: What it allows, no more than the key.
        maps: Slugs of the maps that it is limited to, `None` for all.
        expires_at: It is invalid from then on.
    """

    __tablename__ = "tokens"

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    secret_hash: Mapped[str] = mapped_column(PlainString(255), unique=True)
    key_hash: Mapped[str] = mapped_column(PlainString(255))
    scopes: Mapped[list[str]] = mapped_column(JSON)
    maps: Mapped[list[str] | None] = mapped_column(JSON(none_as_null=True))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime] = mapped_column(index=True)


class AuditRecord(Base):
    """An entry of the audit log; no row is ever changed or removed.

    Attributes:
        seq: Its place, counted from 1 without a gap.
        key_id: Who made the change; no foreign keys: the log outlives its subjects.
        outcome: `done`, or the name of the problem that it ended in.
        hash: SHA-256 over all this and the hash of the entry before.
    """

    __tablename__ = "audit"

    seq: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    at: Mapped[datetime]
    key_id: Mapped[str] = mapped_column(Id, index=True)
    action: Mapped[str] = mapped_column(PlainString(300))
    subject: Mapped[str] = mapped_column(PlainString(300))
    map_slug: Mapped[str | None] = mapped_column(Slug, index=True)
    detail: Mapped[str] = mapped_column(PlainString(300))
    outcome: Mapped[str] = mapped_column(PlainString(100))
    hash: Mapped[str] = mapped_column(Digest, default="")


class AuditHead(Base):
    """Length of the audit log and its last hash: one row, locked by each writer."""

    __tablename__ = "audit_head"

    row: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    seq: Mapped[int] = mapped_column(BigInteger)
    hash: Mapped[str] = mapped_column(Digest)


configure_mappers()  # now and not at the first query: a process forked later has it
