"""Retention over the wire."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.http.shown import Shown
from storage.retention import LONGEST_DAYS, MOST_REVISIONS, RawScans

RetainedRevisions = Annotated[int, Field(ge=0, le=MOST_REVISIONS)] | Literal["all"]
RetainedForDays = Annotated[float, Field(ge=0, le=LONGEST_DAYS, allow_inf_nan=False)]

_COUNT = "How many revisions are kept besides the live and the newest one, or `all`."
_AGE = "How long any revision is kept after it was built or, if it was live, replaced."
_RAW = "Whether the returns of closed drives in the live revision are kept or dropped."


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
