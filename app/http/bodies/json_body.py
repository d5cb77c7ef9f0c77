"""JSON bodies: bounded before they are parsed, with all errors of their model reported."""

import json
import re
from collections import Counter
from typing import Any, TypeVar

import numpy as np
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError

from app.http.errors import InvalidRequest
from app.http.field_problems import MOST_FIELDS, with_names

M = TypeVar("M", bound=BaseModel)

MOST_KEYS = 50_000
"""10,000 poses have 30,001 keys."""
MOST_MEMBERS = 1_000
"""Of one object: each that is unknown costs an error, all made in one call; none has 100 fields."""
MOST_VALUES = 500_000
"""The numbers of 20,000 signatures of rank (5, 5)."""
MOST_DEPTH = 32
"""What the API describes is no deeper than 9."""
SMALL_BYTES = 2**10
"""What is no longer may be parsed on the event loop: the costliest takes some milliseconds."""

_TEXT = re.compile(rb'"[^"]*"')
_STEPS = np.zeros(256, np.int8)
_STEPS[[ord("["), ord("{")]] = 1
_STEPS[[ord("]"), ord("}")]] = -1


def read_json(body: bytes, model: type[M]) -> M:
    """Parse and validate a JSON body; in a thread if it is long, which takes time and memory.

    Raises:
        InvalidRequest: If it, or an object in it, has too many keys, or it has too many values or
            is nested too deep.
        RequestValidationError: If it is no JSON, has a key twice in one object, or does not match
            `model`.
    """
    _require_bounded(body)
    try:
        found = json.loads(body, object_pairs_hook=_object)
    except (ValueError, RecursionError) as error:
        raise RequestValidationError(
            [{"type": "json_invalid", "loc": ("body",), "msg": f"is no JSON: {_reason(error)}"}]
        ) from None
    try:
        return model.model_validate(found)
    except ValidationError as error:
        faults: list[Any] = error.errors(include_url=False, include_context=False)
        faults[:MOST_FIELDS] = [with_names(fault, model) for fault in faults[:MOST_FIELDS]]
        raise RequestValidationError(
            [{**fault, "loc": ("body", *fault["loc"])} for fault in faults], body=found
        ) from None


def _object(members: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a JSON object; of a repeated key no value is more right than the other."""
    if len(members) > MOST_MEMBERS:
        raise InvalidRequest(
            f"an object has {len(members)} keys, at most {MOST_MEMBERS} are read of one"
        )
    found = dict(members)
    if len(found) < len(members):
        [(name, times)] = Counter(name for name, _ in members).most_common(1)
        what = f"came {times} times in one object, wanted once"
        raise RequestValidationError([{"type": "key_twice", "loc": ("body", name), "msg": what}])
    return found


def _reason(error: ValueError | RecursionError) -> str:
    if isinstance(error, json.JSONDecodeError):
        return f"{error.msg} at character {error.pos}"
    return str(error)[:200]


def _require_bounded(body: bytes) -> None:
    """Reject JSON that would take long to parse, in a small part of that time.

    Separators inside strings count too: no string of the API has so many.

    Raises:
        InvalidRequest: If it has too many keys or values, or is nested too deep.
    """
    if len(body) <= SMALL_BYTES:
        return  # the parser's own limits suffice
    keys = body.count(b":")
    if keys > MOST_KEYS:
        raise InvalidRequest(f"the JSON has {keys} keys, at most {MOST_KEYS} are read")
    openings = body.count(b"[") + body.count(b"{")
    values = openings + body.count(b",")
    if values > MOST_VALUES:
        raise InvalidRequest(f"the JSON has {values} values, at most {MOST_VALUES} are read")
    if openings > MOST_DEPTH and (depth := _depth(body)) > MOST_DEPTH:
        raise InvalidRequest(f"the JSON is nested {depth} deep, at most {MOST_DEPTH} is read")


def _depth(body: bytes) -> int:
    plain = _TEXT.sub(b"", body.replace(b"\\\\", b"").replace(b'\\"', b""))
    steps = _STEPS[np.frombuffer(plain, np.uint8)]
    return int(np.cumsum(steps, dtype=np.int32).max(initial=0))
