"""Tokens over the wire; a secret goes out once, when it is exchanged."""

from datetime import datetime

from pydantic import BaseModel, ConfigDict, Field, field_validator

from app.access.scopes import Scope
from app.http.exact_types import SlugText, each_once, integers
from app.http.shown import Shown

_LONGEST_S = 3600


class TokenIn(BaseModel):
    """What a token is wanted for; what is left out is as the key has it."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {"scopes": ["localize"], "maps": ["campus"], "expires_in_s": 900}
        },
    )

    scopes: set[Scope] | None = Field(
        None,
        min_length=1,
        description="What it allows, no more than the key and never `admin`; null for all that.",
    )
    maps: set[SlugText] | None = Field(
        None,
        min_length=1,
        max_length=1000,
        description="The maps that it is limited to, of those of the key; null for all these.",
    )
    expires_in_s: int = Field(
        _LONGEST_S, ge=1, le=_LONGEST_S, description="How many seconds it lasts."
    )

    _sets = field_validator("scopes", "maps", mode="before")(each_once)
    _integers = field_validator("expires_in_s", mode="before")(integers)


class TokenMade(Shown):
    """A token that was exchanged just now."""

    token: str = Field(description="Its id.")
    key: str = Field(description="Id of the key that it was exchanged for.")
    scopes: list[Scope]
    maps: list[str] | None = Field(description="The maps that it is limited to; null for all.")
    expires_at: datetime = Field(description="When it ends, if its key does not end before.")
    secret: str = Field(
        description="What its holder sends as `Authorization: Bearer`; shown this once.",
        examples=["tmt_0123456789abcdef_(43 characters)"],
    )
