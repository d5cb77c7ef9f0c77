"""Shared bases on the wire."""

from datetime import datetime
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from app.http.shown import Shown
from storage.catalog import BasisRecord


class SharedBasisIn(BaseModel):
    """A basis to be shared: its name, and the maps that it is made of."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"example": {"name": "city", "maps": ["campus"]}}
    )

    name: str = Field(
        max_length=64,
        description="Name of the basis, with the rules of a map's name; builds refer to it.",
    )
    maps: list[Annotated[str, Field(max_length=64)]] = Field(
        min_length=1,
        max_length=100,
        description="Maps to take the basis from. One: its live revision's; several: one fitted to"
        " all drives of their live revisions.",
    )


class SharedBasisOut(Shown):
    """A shared basis."""

    name: str
    basis: str = Field(description="The basis's digest, which signatures made with it contain.")
    encoding: str
    size_bytes: int
    created_at: datetime

    @classmethod
    def from_record(cls, record: BasisRecord) -> "SharedBasisOut":
        """Return the model of a basis's record."""
        return cls.of(record, basis=record.digest)
