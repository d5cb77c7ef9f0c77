"""The catalog's tables. Every change here comes with a migration beside it."""

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    DateTime,
    Dialect,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    MetaData,
    String,
    Text,
    TypeDecorator,
    UniqueConstraint,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, configure_mappers, mapped_column


def plain(text: str) -> str:
    """Return a text as it is stored: PostgreSQL has no NUL, U+FFFD stands for it everywhere."""
    return text.replace("\0", "\N{REPLACEMENT CHARACTER}")


class PlainString(TypeDecorator[str]):
    """A string; to look for a name with a NUL in it finds nothing, on any database."""

    impl = String
    cache_ok = True

    def process_bind_param(  # dialect: SQLAlchemy's signature
        self,
        value: str | None,
        dialect: Dialect,  # noqa: ARG002
    ) -> str | None:
        """Replace NUL."""
        return None if value is None else plain(value)


class PlainText(PlainString):
    """As `PlainString`, of any length."""

    impl = Text
    cache_ok = True


Id = PlainString(32)
# In the order of its bytes, whatever language the database speaks.
Slug = PlainString(64).with_variant(PlainString(64, collation="C"), "postgresql")
Digest = PlainString(64)


class UtcDateTime(TypeDecorator[datetime]):
    """A moment in UTC; SQLite forgets the zone and would return a naive one."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(  # dialect: SQLAlchemy's signature
        self,
        value: datetime | None,
        dialect: Dialect,  # noqa: ARG002
    ) -> datetime | None:
        """Refuse a naive moment, store an aware one in UTC."""
        if value is not None and value.tzinfo is None:
            raise ValueError(f"{value} has no time zone")
        return None if value is None else value.astimezone(UTC)

    def process_result_value(
        self,
        value: datetime | None,
        dialect: Dialect,  # noqa: ARG002
    ) -> datetime | None:
        """Return an aware moment in UTC."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Base(DeclarativeBase):
    """Names every constraint, so that a later migration can drop it on any database."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map = {datetime: UtcDateTime}  # noqa: RUF012  # SQLAlchemy's own declaration


class StoreId(Base):
    """Which data directory the catalog belongs to: one row, once it belongs to one."""

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
    version: Mapped[int]
    # What it has chosen of `storage.retention.Retention`; the service's defaults fill in the rest.
    retention: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))


class Drive(Base):
    """A recording that belongs to a map."""

    __tablename__ = "drives"
    __table_args__ = (UniqueConstraint("map_id", "slug"),)

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    map_id: Mapped[str] = mapped_column(Id, ForeignKey("maps.id", ondelete="CASCADE"))
    slug: Mapped[str] = mapped_column(Slug)
    created_at: Mapped[datetime]
    closed: Mapped[bool]


class Scan(Base):
    """One scan of a drive and the place of its returns."""

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
    """Where and when a scan that is still to come was taken; it goes when the scan is there."""

    __tablename__ = "expected_poses"

    drive_id: Mapped[str] = mapped_column(
        Id, ForeignKey("drives.id", ondelete="CASCADE"), primary_key=True
    )
    index: Mapped[int] = mapped_column("scan_index", BigInteger, primary_key=True)
    timestamp_s: Mapped[float | None]
    pose: Mapped[list[float] | None] = mapped_column(JSON(none_as_null=True))


class Revision(Base):
    """A built revision of a map; the same digest may stand in several maps."""

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
    # Not a foreign key: a revision outlives the list of jobs.
    job_id: Mapped[str | None] = mapped_column(Id)
    created_at: Mapped[datetime]
    # By slug. Not foreign keys: a revision outlives its drives. None of one from elsewhere.
    drive_ids: Mapped[dict[str, str] | None] = mapped_column(JSON(none_as_null=True))
    # When it was built last or, if it was live later, replaced; None only to a downgraded schema.
    retained_from: Mapped[datetime | None]


class RevisionBasis(Base):
    """A basis that a revision answers to; many revisions may share one."""

    __tablename__ = "revision_bases"
    __table_args__ = (
        ForeignKeyConstraint(
            ["map_id", "digest"], ["revisions.map_id", "revisions.digest"], ondelete="CASCADE"
        ),
    )

    map_id: Mapped[str] = mapped_column(Id, primary_key=True)
    basis: Mapped[str] = mapped_column(Digest, primary_key=True)
    digest: Mapped[str] = mapped_column(Digest, primary_key=True)


class LiveRevision(Base):
    """Which revision of a map is live.

    A table, not a column of maps: maps and revisions would refer to each other in a circle, which
    SQLite cannot alter. So the database itself refuses to delete a live revision.
    """

    __tablename__ = "live_revisions"
    __table_args__ = (
        ForeignKeyConstraint(["map_id", "digest"], ["revisions.map_id", "revisions.digest"]),
    )

    map_id: Mapped[str] = mapped_column(
        Id, ForeignKey("maps.id", ondelete="CASCADE"), primary_key=True
    )
    digest: Mapped[str] = mapped_column(Digest)


class Job(Base):
    """A long computation for a map."""

    __tablename__ = "jobs"
    __table_args__ = (
        Index(None, "created_at", "id"),
        Index(None, "state", "created_at"),
        Index(None, "key_id", "started_at"),
        Index("ix_jobs_request_key", "map_id", "request_key", unique=True),
    )

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    map_id: Mapped[str] = mapped_column(Id, ForeignKey("maps.id", ondelete="CASCADE"), index=True)
    kind: Mapped[str] = mapped_column(PlainString(32))
    state: Mapped[str] = mapped_column(PlainString(16))
    stage: Mapped[str] = mapped_column(PlainString(64))
    done_units: Mapped[int] = mapped_column(BigInteger)
    total_units: Mapped[int] = mapped_column(BigInteger)
    parameters: Mapped[dict[str, Any]] = mapped_column(JSON)
    plan: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    error_type: Mapped[str | None] = mapped_column(PlainString(128))
    error_detail: Mapped[str | None] = mapped_column(PlainText())
    # Not a foreign key: a job remembers what it built after that was deleted.
    revision: Mapped[str | None] = mapped_column(Digest)
    cancel_requested: Mapped[bool]
    notes: Mapped[list[str] | None] = mapped_column(JSON(none_as_null=True))
    result: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    # Of the request that made it, if it said so: who repeats that is given the same job.
    request_key: Mapped[str | None] = mapped_column(PlainString(255))
    request_digest: Mapped[str | None] = mapped_column(Digest)
    # Of who asked for it; not a foreign key: the operator's is in no table. None of earlier jobs.
    key_id: Mapped[str | None] = mapped_column(Id)
    created_at: Mapped[datetime]
    started_at: Mapped[datetime | None]
    stage_started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]


class Key(Base):
    """An API key."""

    __tablename__ = "keys"

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    name: Mapped[str] = mapped_column(PlainString(100))
    secret_hash: Mapped[str] = mapped_column(PlainString(255), unique=True)
    scopes: Mapped[list[str]] = mapped_column(JSON)
    # Slugs, not ids: a key may be made before its map. None: all maps.
    maps: Mapped[list[str] | None] = mapped_column(JSON(none_as_null=True))
    first_run: Mapped[bool]
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]


class Token(Base):
    """What was exchanged for a key for a short time."""

    __tablename__ = "tokens"

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    secret_hash: Mapped[str] = mapped_column(PlainString(255), unique=True)
    # Not a foreign key: it may be the key of the settings, which is in no table.
    key_hash: Mapped[str] = mapped_column(PlainString(255))
    scopes: Mapped[list[str]] = mapped_column(JSON)
    maps: Mapped[list[str] | None] = mapped_column(JSON(none_as_null=True))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime] = mapped_column(index=True)


class AuditEntry(Base):
    """What somebody changed, or was refused to; no row is ever changed or removed."""

    __tablename__ = "audit"

    seq: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    at: Mapped[datetime]
    # No foreign keys: the log outlives what it is about.
    key_id: Mapped[str] = mapped_column(Id, index=True)
    action: Mapped[str] = mapped_column(PlainString(300))
    subject: Mapped[str] = mapped_column(PlainString(300))
    map_slug: Mapped[str | None] = mapped_column(Slug, index=True)
    detail: Mapped[str] = mapped_column(PlainString(300))
    outcome: Mapped[str] = mapped_column(PlainString(100))
    hash: Mapped[str] = mapped_column(Digest)


class AuditHead(Base):
    """How long the audit log is: one row, locked by whoever adds to it."""

    __tablename__ = "audit_head"

    row: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    seq: Mapped[int] = mapped_column(BigInteger)
    hash: Mapped[str] = mapped_column(Digest)


configure_mappers()  # now and not at the first query: a process forked later has it
