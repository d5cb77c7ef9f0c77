"""Tables of maps, drives, scans, revisions and bases."""

from datetime import datetime
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    UniqueConstraint,
    false,
    select,
)
from sqlalchemy.orm import (
    Mapped,
    mapped_column,
)

from storage.catalog.columns import (
    Digest,
    Id,
    PlainString,
    PlainText,
    Slug,
    Values,
)
from storage.catalog.models.base import Base


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
    # The fields of its `core.mapping.anchor.Anchor`, `None` without one.
    anchor: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True), default=None)


class Drive(Base):
    """A recording that belongs to a map.

    Attributes:
        mounting: The fields of its `core.scans.mounting.Mounting`, `None` without one.
        accumulate: How many consecutive scans become one of a map.
        odometry: How its poses were computed, in plain values; `None` if they were given.
        pose_check: How given poses agree with the scans, in plain values; `None` if not checked.
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
    odometry: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True), default=None)
    pose_check: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True), default=None)


class Recycled(Base):
    """A deleted map or drive, whose row has a slug that no client can choose.

    Attributes:
        id: The id of the map or drive.
        map_id: The map itself, or that of the drive.
        drive_id: The drive, `None` for a map.
        slug: The name that it had.
        created_at: When it was deleted.
        purging: Whether it is being removed for good, and its rows are no longer whole.
    """

    __tablename__ = "recycle_bin"

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    map_id: Mapped[str] = mapped_column(Id, ForeignKey("maps.id", ondelete="CASCADE"))
    drive_id: Mapped[str | None] = mapped_column(Id, ForeignKey("drives.id", ondelete="CASCADE"))
    slug: Mapped[str] = mapped_column(Slug)
    created_at: Mapped[datetime]
    purging: Mapped[bool] = mapped_column(server_default=false(), default=False)


class PurgedMap(Base):
    """A name of maps that were removed for good.

    Attributes:
        slug: The name.
        version: The highest version of a map that had it.
    """

    __tablename__ = "purged_maps"

    slug: Mapped[str] = mapped_column(Slug, primary_key=True)
    version: Mapped[int]


PURGED = select(Recycled.id).where(Recycled.purging)
"""The ids of maps and drives that are being removed for good."""


class Scan(Base):
    """One scan of a drive and the location of its returns.

    Attributes:
        pose_sigma: Standard deviations of a computed pose, metres and degrees; `None` of others.
    """

    __tablename__ = "scans"
    __table_args__ = (Index("ix_scans_drive_id_chunk", "drive_id", "chunk"),)

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
    pose_sigma: Mapped[list[float] | None] = mapped_column(JSON(none_as_null=True), default=None)


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
        number: Counts the map's revisions in the order in which they were added, whatever the clock
            said.
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
    number: Mapped[int] = mapped_column(BigInteger, server_default="0", default=0)


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
