"""Strict types of values on the wire.

By default pydantic reads `"5"` and `true` as numbers, `1` as the literal `true`, `0.5` as a time in
1970, and a list with a repeated name as a set: the API does not describe that, and it is probably
a client's error.

`integers`, `integer_or_all(most)`, `truth_values` and `each_once` are for `field_validator(...,
mode="before")`: within an annotation they would hide a field's bounds from the OpenAPI document.
"""

import re
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from typing import Annotated

from pydantic import AfterValidator, AwareDatetime, BeforeValidator, Field, Strict
from pydantic_core import PydanticCustomError, PydanticKnownError

from core.scans.times import LATEST_S, flaw_of_time
from core.text import flaw_in
from storage.names import SLUG_PATTERN

_RFC_3339 = re.compile(
    r"[0-9]{4}-[0-9]{2}-[0-9]{2}[Tt ][0-9]{2}:[0-9]{2}:[0-9]{2}(\.[0-9]+)?"
    r"([Zz]|[+-][0-9]{2}:[0-9]{2})"
)


def integers(given: object) -> object:
    """Reject strings and booleans as integers, also in a list."""
    # Not `Strict`: in JSON Schema 5.0 is an integer too, and some clients send it.
    if any(isinstance(item, bool | str) for item in _items_of(given)):
        raise PydanticKnownError("int_type")
    return given


def integer_or_all(most: int) -> Callable[[object], object]:
    """Return what rejects all but an integer from 0 to `most`, `all` and null, in one text.

    Of a union pydantic reports what is wrong with each type that it tried.
    """

    def checked(given: object) -> object:
        is_one = given is None or given == "all"
        if isinstance(given, int | float) and not isinstance(given, bool):
            is_one = 0 <= given <= most and given % 1 == 0  # 5.0 is an integer in JSON Schema
        if not is_one:
            raise PydanticCustomError(
                "integer_or_all",
                "should be a whole number from 0 to {most}, or 'all'",
                {"most": most},
            )
        return given

    return checked


def truth_values(given: object) -> object:
    """Reject numbers and strings as `Literal[True]`, which cannot be `Strict`."""
    if not isinstance(given, bool):
        raise PydanticKnownError("bool_type")
    return given


def in_digits(given: object) -> object:
    """Reject other texts that Python reads as an integer, such as `+1`, `1_0` and `1.0`."""
    if not (isinstance(given, str) and re.fullmatch(r"-?[0-9]+", given)):
        raise PydanticKnownError("int_parsing")
    return given


def _true_or_false(given: object) -> object:
    if given not in {"true", "false"}:
        raise PydanticCustomError("flag", "wanted true or false")
    return given == "true"


def _written_out(given: object) -> object:
    if not (isinstance(given, str) and _RFC_3339.fullmatch(given)):
        raise PydanticCustomError(
            "moment", "wanted a moment as RFC 3339 writes it, as 2030-01-01T00:00:00Z"
        )
    return given


def _in_utc(given: datetime) -> datetime:
    """Return a time in UTC; near the ends of the calendar its offset may lead out of it."""
    try:
        return given.astimezone(UTC)
    except OverflowError:
        raise PydanticCustomError(
            "moment", "wanted a moment that is in the years 1 to 9999 in UTC too"
        ) from None


def each_once(given: object) -> object:
    """Reject a list with a repeated name as a set."""
    texts = [item for item in _items_of(given) if isinstance(item, str)]
    if len(set(texts)) < len(texts):
        raise PydanticCustomError("each_once", "an item comes twice")
    return given


def _items_of(given: object) -> list[object]:
    return given if isinstance(given, list) else [given]


def _checked(given: str, allowed: str = "") -> str:
    flaw = flaw_in(given, len(given), allowed=allowed) if given else None
    if flaw is not None:
        raise PydanticCustomError("text", "{flaw}, wanted text that can be shown", {"flaw": flaw})
    return given


def _seconds(given: float) -> float:
    flaw = flaw_of_time(given)
    if flaw is not None:
        raise PydanticCustomError("seconds", "{flaw}", {"flaw": f"it is {flaw}"})
    return given


Flag = Annotated[bool, Strict()]
QueryFlag = Annotated[bool, BeforeValidator(_true_or_false)]
"""A flag of a query, where pydantic by itself reads `yes`, `on`, `t` and `1` as true."""
Number = Annotated[float, Strict()]
# pydantic's own text of a bound would not say that seconds are wanted.
Seconds = Annotated[
    float,
    AfterValidator(_seconds),
    Field(json_schema_extra={"minimum": -LATEST_S, "maximum": LATEST_S}),
]
"""A time by any clock; of JSON `Annotated[Seconds, Strict()]`."""
Moment = Annotated[AwareDatetime, BeforeValidator(_written_out), AfterValidator(_in_utc)]
# The same characters as in `core.text`; JSON has no halves of surrogate pairs.
_UNSHOWN = r"\u007f-\u009f\u2028-\u202e\u2066-\u2069"
_NAME = {"pattern": rf"^[^\u0000-\u001f{_UNSHOWN}]*$"}
_LINES = {"pattern": rf"^[^\u0000-\u0008\u000b\u000c\u000e-\u001f{_UNSHOWN}]*$"}
Name = Annotated[str, AfterValidator(_checked), Field(json_schema_extra=_NAME)]
"""Text of one line, without control characters."""
Lines = Annotated[
    str, AfterValidator(partial(_checked, allowed="\t\n\r")), Field(json_schema_extra=_LINES)
]
"""Text of any lines, without other control characters."""
# Described only: `storage.names` rejects other names with an error of its own.
SlugText = Annotated[str, Field(json_schema_extra={"pattern": SLUG_PATTERN})]
