"""Keys and tokens over the wire; a secret is sent once, when it is made."""

from datetime import datetime

from pydantic import BaseModel, ConfigDict, Field, field_validator

from app.access.scopes import Scope
from app.http.exact_types import Moment, Name, SlugText, each_once, integers
from app.http.shown import Shown

_MOST_MAPS = 1000
# The audit log keeps an entry of each exchange: a key adds no more of them than it may have tokens
# at once in this time.
_SHORTEST_S = 60
_LONGEST_S = 3600


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
        min_length=1,
        description="What the key allows; no scope implies another, but `admin` implies all.",
    )
    maps: set[SlugText] | None = Field(
        None,
        min_length=1,
        max_length=_MOST_MAPS,
        description="The maps that the key is limited to, existing or not; null for all.",
    )
    expires_at: Moment | None = Field(
        None, description="When the key expires, with a time zone; null for never."
    )

    _sets = field_validator("scopes", "maps", mode="before")(each_once)


class KeyOut(Shown):
    """A key, without its secret."""

    key: str = Field(description="The key's id, the part after `tm_`.")
    name: str
    scopes: list[Scope]
    maps: list[str] | None = Field(description="The maps that it is limited to; null for all.")
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None
    in_use: bool = Field(
        description="Whether it is accepted: it is neither expired nor revoked, nor the generated"
        " key of a service with `TENSORMAP_ADMIN_KEY`."
    )


class KeyMade(KeyOut):
    """A key that was made just now."""

    secret: str = Field(
        description="What its holder sends as `Authorization: Bearer`; shown this once.",
        examples=["tm_0123456789abcdef_(43 characters)"],
    )


class TokenIn(BaseModel):
    """A token to be made; what is left out is as the key has it."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {"scopes": ["localize"], "maps": ["campus"], "expires_in_s": 900}
        },
    )

    scopes: set[Scope] | None = Field(
        None,
        min_length=1,
        description="What it allows, no more than the key, never `admin` or `metrics`; null for all"
        " that.",
    )
    maps: set[SlugText] | None = Field(
        None,
        min_length=1,
        max_length=_MOST_MAPS,
        description="The maps that it is limited to, of those of the key; null for all these.",
    )
    expires_in_s: int = Field(
        _LONGEST_S, ge=_SHORTEST_S, le=_LONGEST_S, description="How many seconds the token lasts."
    )

    _sets = field_validator("scopes", "maps", mode="before")(each_once)
    _integers = field_validator("expires_in_s", mode="before")(integers)


class TokenMade(Shown):
    """A token that was made just now."""

    token: str = Field(description="The token's id.")
    key: str = Field(description="Id of the key that the token was exchanged for.")
    scopes: list[Scope]
    maps: list[str] | None = Field(description="The maps that it is limited to; null for all.")
    expires_at: datetime = Field(
        description="When the token expires, unless its key expires earlier."
    )
    secret: str = Field(
        description="What its holder sends as `Authorization: Bearer`; shown this once.",
        examples=["tmt_0123456789abcdef_(43 characters)"],
    )
