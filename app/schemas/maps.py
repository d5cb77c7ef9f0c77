"""Maps over the wire."""

from datetime import datetime

from pydantic import BaseModel, ConfigDict, Field

from app.schemas.exact import SlugText
from storage.catalog import MapRecord

__all__ = ["MapIn", "MapOut", "MapPatch"]


class MapIn(BaseModel):
    """A map to be made."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"example": {"map": "campus", "description": "Loop around the campus"}},
    )

    map: SlugText = Field(
        description="Its name: 1 to 64 of a-z, 0-9, `.`, `_`, `-`; a letter or digit first."
    )
    description: str = Field("", max_length=2000)


class MapPatch(BaseModel):
    """What changes of a map."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"example": {"description": "Loop around the campus"}}
    )

    description: str = Field(max_length=2000)


class MapOut(BaseModel):
    """A map."""

    map: str
    description: str
    created_at: datetime
    version: int = Field(description="Counts its changes; also its ETag.")
    live_revision: str | None = Field(
        description="Digest of the revision that answers scan queries; null before the first build."
    )

    @classmethod
    def from_record(cls, record: MapRecord) -> "MapOut":
        """Show a map's record."""
        return cls(
            map=record.slug,
            description=record.description,
            created_at=record.created_at,
            version=record.version,
            live_revision=record.live_revision,
        )
