"""Maps over the wire."""

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from app.http.exact_types import Lines, Number, SlugText, integer_or_all
from app.http.shown import Shown, is_none
from storage.catalog import MapRecord
from storage.retention import LONGEST_DAYS, MOST_REVISIONS, RawScans, Retention

RetainedRevisions = Annotated[int, Field(ge=0, le=MOST_REVISIONS)] | Literal["all"]
RetainedForDays = Annotated[Number, Field(ge=0, le=LONGEST_DAYS, allow_inf_nan=False)]

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
        description="The map's name: 1 to 64 of a-z, 0-9, `.`, `_`, `-`; a letter or digit first."
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

    _integer_or_all = field_validator("retained_revisions", mode="before")(
        integer_or_all(MOST_REVISIONS)
    )


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


class MapAnchorIn(BaseModel):
    """A point of a map whose place on the Earth is known, and how the map is turned."""

    model_config = ConfigDict(
        extra="forbid",
        allow_inf_nan=False,
        json_schema_extra={"example": {"latitude_deg": 49.01, "longitude_deg": 8.4}},
    )

    latitude_deg: Number = Field(ge=-90, le=90, description="Latitude of the point, WGS84.")
    longitude_deg: Number = Field(ge=-180, le=180, description="Longitude of the point, WGS84.")
    altitude_m: Number = Field(
        0.0, ge=-1e5, le=1e5, description="Altitude of the point above the ellipsoid."
    )
    heading_deg: Number = Field(
        0.0, ge=-360, le=360, description="Angle of the map's x axis, counter-clockwise from east."
    )
    x_m: Number = Field(0.0, ge=-1e8, le=1e8, description="x of the point in the map.")
    y_m: Number = Field(0.0, ge=-1e8, le=1e8, description="y of the point in the map.")
    z_m: Number = Field(0.0, ge=-1e8, le=1e8, description="z of the point in the map.")


class AnchorFitOut(Shown):
    """How an anchor was fitted to the track of a GNSS receiver."""

    drive: str
    fixes: int = Field(description="Fixes that were compared, some metres apart.")
    agreeing: int = Field(description="How many of them the anchor was fitted to.")
    spread_m: float = Field(description="Standard deviation of a fix in x and y, each.")
    error_m: float = Field(description="Standard deviation of the anchor's point.")
    error_deg: float = Field(description="Standard deviation of the anchor's heading.")
    altitudes: int | None = Field(
        None,
        exclude_if=is_none,
        description="How many of the agreeing fixes have an altitude: with 0 the anchor's is"
        " unknown, and is 0. Not of anchors that earlier releases fitted.",
    )


class MapAnchorOut(Shown):
    """The anchor of a map."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    heading_deg: float
    x_m: float
    y_m: float
    z_m: float
    fitted: AnchorFitOut | None = Field(
        None, exclude_if=is_none, description="How well it fits; only if it was fitted to a track."
    )


class MapPatch(BaseModel):
    """Changes of a map; what is not given stays."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            # `/docs` fills in the first one to be sent: it removes nothing.
            "examples": [
                {"description": "Loop around the campus"},
                {"retention": {"retained_revisions": 5, "raw_scans": "drop"}},
            ],
        },
    )

    description: Lines | None = Field(None, max_length=2000)
    retention: RetentionPatch | None = Field(
        None, description="What is kept; what is no longer kept is removed at once."
    )

    anchor: MapAnchorIn | None = Field(
        None,
        description="Where the map is on the Earth: answers, tracks and graphs then have WGS84"
        " beside metres. Null removes it.",
    )

    @model_validator(mode="after")
    def _changes_something(self) -> "MapPatch":
        anchored = "anchor" in self.model_fields_set
        if self.description is None and self.retention is None and not anchored:
            raise ValueError("wanted description, retention or anchor")
        return self


class MapOut(Shown):
    """A map."""

    map: str
    description: str
    created_at: datetime
    version: int = Field(
        description="Counts its changes, from those of deleted maps of its name on; also its ETag."
    )
    live_revision: str | None = Field(
        description="Digest of the revision that answers scan queries; null before the first build."
    )
    retention: OwnRetentionOut = Field(
        description="The map's own retention; null where the service's default is in force."
    )
    retention_in_force: RetentionOut
    anchor: MapAnchorOut | None = Field(description="Where it is on the Earth; null if not set.")

    @classmethod
    def from_record(cls, record: MapRecord, default: Retention) -> "MapOut":
        """Show a map's record, with the default retention."""
        in_force = RetentionOut.of(record.retention.over(default))
        return cls.of(record, map=record.slug, retention_in_force=in_force)
