"""Keys over the wire; a secret goes out once, when it is made."""

from datetime import UTC, datetime

from pydantic import BaseModel, ConfigDict, Field, field_validator

from app.access.scopes import Scope
from app.http.exact_types import Moment, Name, SlugText, each_once
from app.http.shown import Shown
from storage.catalog import KeyRecord

_MOST_MAPS = 1000


class KeyIn(BaseModel):
    """A key to be made."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {
                "name": "fleet in the north",
                "scopes": ["localize"],
                "maps": ["campus"],
                "expires_at": "2030-01-01T00:00:00Z",
            }
        },
    )

    name: Name = Field(min_length=1, max_length=100, description="What the key is for.")
    scopes: set[Scope] = Field(
        min_length=1, description="What it allows; none implies another, but `admin` implies all."
    )
    maps: set[SlugText] | None = Field(
        None,
        min_length=1,
        max_length=_MOST_MAPS,
        description="The maps that it is limited to, there already or not; null for all.",
    )
    expires_at: Moment | None = Field(
        None, description="When it ends, with a time zone; null for never."
    )

    _sets = field_validator("scopes", "maps", mode="before")(each_once)


class KeyOut(Shown):
    """A key, without its secret."""

    key: str = Field(description="Its id, the part after `tm_`.")
    name: str
    scopes: list[Scope]
    maps: list[str] | None = Field(description="The maps that it is limited to; null for all.")
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None
    in_use: bool = Field(description="Whether it is neither expired nor revoked.")

    @classmethod
    def from_record(cls, record: KeyRecord) -> "KeyOut":
        """Show a key's record."""
        return cls.of(record, key=record.id, in_use=record.opens_at(datetime.now(UTC)))


class KeyMade(KeyOut):
    """A key that was made just now."""

    secret: str = Field(
        description="What its holder sends as `Authorization: Bearer`; shown this once.",
        examples=["tm_0123456789abcdef_(43 characters)"],
    )
