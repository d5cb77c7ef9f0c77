"""Deleted maps and drives over the wire."""

from datetime import datetime, timedelta
from typing import Literal

from pydantic import Field

from app.http.shown import Shown
from storage.catalog import RecycledRecord


class RecycledOut(Shown):
    """A deleted map or drive."""

    entry: str = Field(description="Identifies it, to restore or purge it.")
    kind: Literal["map", "drive"]
    map: str = Field(description="The map's name, or that of the drive's map.")
    drive: str | None = Field(description="The drive's name; null for a map.")
    deleted_at: datetime = Field(
        description="When it was deleted; of a drive whose map was deleted after it, when that was"
        " restored."
    )
    kept_until: datetime = Field(description="When the entry is removed for good.")
    size_bytes: int = Field(
        description="What its returns, and a map's revisions and parts of captures, take on disk."
    )

    @classmethod
    def from_record(cls, record: RecycledRecord, kept_days: float) -> "RecycledOut":
        """Show an entry, which is kept for some days."""
        return cls.of(
            record,
            entry=record.id,
            kind="map" if record.drive_slug is None else "drive",
            map=record.map_slug,
            drive=record.drive_slug,
            kept_until=record.deleted_at + timedelta(days=kept_days),
        )


class RestoredOut(Shown):
    """What was restored."""

    kind: Literal["map", "drive"]
    map: str = Field(description="The map's name, or that of the drive's map.")
    drive: str | None = Field(description="The drive's name; null for a map.")
