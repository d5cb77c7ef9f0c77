"""Maps over the wire."""

from datetime import datetime

from pydantic import BaseModel, ConfigDict, Field, model_validator

from app.http.exact_types import Lines, SlugText
from app.http.shown import Shown
from app.maps.retention_schemas import OwnRetentionOut, RetentionOut, RetentionPatch
from storage.catalog import MapRecord
from storage.retention import Retention


class MapIn(BaseModel):
    """A map to be made."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"example": {"map": "campus", "description": "Loop around the campus"}},
    )

    map: SlugText = Field(
        description="Its name: 1 to 64 of a-z, 0-9, `.`, `_`, `-`; a letter or digit first."
    )
    description: Lines = Field("", max_length=2000)


class MapPatch(BaseModel):
    """Changes of a map; what is not given stays."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {"description": "Loop around the campus"},
            "examples": [{"retention": {"retained_revisions": 5, "raw_scans": "drop"}}],
        },
    )

    description: Lines | None = Field(None, max_length=2000)
    retention: RetentionPatch | None = Field(
        None, description="What is kept; what is no longer kept is removed at once."
    )

    @model_validator(mode="after")
    def _changes_something(self) -> "MapPatch":
        if self.description is None and self.retention is None:
            raise ValueError("wanted description or retention")
        return self


class MapOut(Shown):
    """A map."""

    map: str
    description: str
    created_at: datetime
    version: int = Field(description="Counts its changes; also its ETag.")
    live_revision: str | None = Field(
        description="Digest of the revision that answers scan queries; null before the first build."
    )
    retention: OwnRetentionOut = Field(
        description="The map's own retention; null where the service's default is in force."
    )
    retention_in_force: RetentionOut

    @classmethod
    def from_record(cls, record: MapRecord, default: Retention) -> "MapOut":
        """Show a map's record, with the default retention."""
        in_force = RetentionOut.of(record.retention.over(default))
        return cls.of(record, map=record.slug, retention_in_force=in_force)
