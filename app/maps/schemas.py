"""Maps over the wire."""

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from app.http.exact_types import Lines, SlugText
from app.http.shown import Shown
from storage.catalog import MapRecord
from storage.retention import LONGEST_DAYS, MOST_REVISIONS, RawScans, Retention

RetainedRevisions = Annotated[int, Field(ge=0, le=MOST_REVISIONS)] | Literal["all"]
RetainedForDays = Annotated[float, Field(ge=0, le=LONGEST_DAYS, allow_inf_nan=False)]

_COUNT = "How many revisions are kept besides the live and the newest one, or `all`."
_AGE = "How long any revision is kept after it was built or, if it was live, replaced."
_RAW = "Whether the returns of closed drives in the live revision are kept or dropped."


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


class RetentionPatch(BaseModel):
    """Changes of a map's retention; null restores the service's default."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"example": {"retained_revisions": 5, "retained_for_days": 30}},
    )

    retained_revisions: RetainedRevisions | None = Field(None, description=_COUNT)
    retained_for_days: RetainedForDays | None = Field(None, description=_AGE)
    raw_scans: RawScans | None = Field(None, description=_RAW)


class OwnRetentionOut(Shown):
    """A map's own retention; null where the service's default is in force."""

    retained_revisions: RetainedRevisions | None = Field(description=_COUNT)
    retained_for_days: RetainedForDays | None = Field(description=_AGE)
    raw_scans: RawScans | None = Field(description=_RAW)


class RetentionOut(Shown):
    """The retention in force."""

    retained_revisions: RetainedRevisions = Field(description=_COUNT)
    retained_for_days: RetainedForDays = Field(description=_AGE)
    raw_scans: RawScans = Field(description=_RAW)


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
