"""What is wrong with the parameters or the JSON of a request, in words for its sender.

pydantic's own name Python's classes, and seldom what was received.
"""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, get_args

from app.http.redaction import without_keys

if TYPE_CHECKING:  # commands word problems of options too, and do not import FastAPI
    from fastapi.exceptions import RequestValidationError
    from pydantic import BaseModel

MOST_FIELDS = 20
"""How many problems are reported: a body of 100,000 poses may be wrong 700,000 times."""
_MOST_OF_WHERE = 200  # characters
_MOST_OF_WHAT = 1_000  # the names of a route's parameters take half of it
_MOST_SHOWN = 80  # of the client's text

_OBJECT = "should be an object"
_WORDS = {
    "missing": "is missing",
    "extra_forbidden": "is no field of this object",
    "int_parsing": "should be a valid integer",
    "int_from_float": "should be a valid integer",
    "float_parsing": "should be a valid number",
    "bool_type": "should be true or false",
    "model_type": _OBJECT,
    "model_attributes_type": _OBJECT,
    "dict_type": _OBJECT,
}
"""Texts by pydantic's type of the error, where its own words are not those of the API."""
# The input of these is the object around, a field that may hold anything, or in the text already.
_SHOW_NOTHING = {"missing", "extra_forbidden", "field_name", "seconds"}
_SHOW_KIND = {"model_type", "model_attributes_type", "dict_type", "list_type", "string_type"}
_LENGTHS = {"too_long", "too_short"}
_SUBJECT = re.compile(r"Value error, |[A-Z]\w* (?=should )")


def field_problems(error: "RequestValidationError") -> list[dict[str, str]]:
    """Return the first problems of a request: `where`, and `what` was wanted and received."""
    return [
        {
            "where": _sendable("/".join(_place(fault, error.body)))[:_MOST_OF_WHERE],
            "what": _sendable(wanted_and_got(fault))[:_MOST_OF_WHAT],
        }
        for fault in error.errors()[:MOST_FIELDS]
    ]


def _place(fault: dict[str, Any], body: Any) -> Iterator[str]:  # noqa: ANN401 - JSON
    """Yield the parts of a path; between those of a body pydantic names the types that it tried.

    Without a body, as of a query or of a rule of our own, all are parts.
    """
    source, *parts = fault["loc"]
    is_plain = body is None
    yield str(source)
    for number, part in enumerate(parts, 1):
        if _has(body, part):
            body = body[part]
            yield str(part)
        elif is_plain or (fault["type"] == "missing" and number == len(parts)):
            yield str(part)


def _has(body: Any, part: str | int) -> bool:  # noqa: ANN401 - JSON
    if isinstance(body, list):
        return isinstance(part, int) and part < len(body)
    return isinstance(body, dict) and part in body


def with_names(fault: Mapping[str, Any], model: "type[BaseModel]") -> Mapping[str, Any]:
    """Return what is wrong; of an unknown field with those that its object has."""
    if fault["type"] != "extra_forbidden":
        return fault
    found = _model_at(model, fault["loc"][:-1])
    if found is None:
        return fault
    what = f"is no field of this object, it has {', '.join(sorted(_fields_of(found)))}"
    return {**fault, "type": "field_name", "msg": what}


def _model_at(model: "type[BaseModel]", place: Iterable[str | int]) -> "type[BaseModel] | None":
    """Return the model of a nested object, `None` where several may be meant."""
    for part in place:
        if isinstance(part, int):  # of a list
            continue
        kinds = _types_in(_fields_of(model).get(part))
        models = {kind for kind in kinds if hasattr(kind, "model_fields")}
        if len(models) != 1:
            return None
        model = models.pop()
    return model


def _fields_of(model: "type[BaseModel]") -> dict[str, Any]:
    """Return the annotations of a model's fields by their names on the wire."""
    fields = model.model_fields.items()
    return {field.alias or name: field.annotation for name, field in fields}


def _types_in(annotation: Any) -> Iterator[Any]:  # noqa: ANN401 - of a field
    yield annotation
    for one in get_args(annotation):
        yield from _types_in(one)


def wanted_and_got(fault: Mapping[str, Any]) -> str:
    """Return what was wanted and received, of one of pydantic's errors."""
    kind = fault["type"]
    wanted = _WORDS.get(kind) or _SUBJECT.sub("", str(fault["msg"]), count=1)
    if kind == "literal_error":
        wanted = wanted.replace("should be True", "should be true")
    if kind in _LENGTHS:
        wanted = wanted.replace(" after validation", "")
        if isinstance(fault["input"], str):  # pydantic forgets that it counts a text's characters
            wanted = wanted.replace(" items", " characters")
    if kind in _SHOW_NOTHING or "input" not in fault:
        return wanted
    got = _shown(fault["input"], kind)
    return wanted if got is None or f" {got}" in wanted else f"{wanted}, got {got}"


def _shown(got: Any, kind: str) -> str | None:  # noqa: ANN401 - JSON, or the text of a parameter
    if isinstance(got, str):
        text = without_keys(got[: 2 * _MOST_SHOWN])
        return repr(text if len(text) <= _MOST_SHOWN else f"{text[: _MOST_SHOWN - 3]}...")
    if got is None or isinstance(got, bool | int | float):
        return json.dumps(got)[:_MOST_SHOWN]
    if kind in _SHOW_KIND and isinstance(got, list | dict):
        return "a list" if isinstance(got, list) else "an object"
    return None


def _sendable(text: str) -> str:
    # JSON may hold halves of surrogate pairs, which UTF-8 has not.
    return without_keys(text.encode(errors="backslashreplace").decode())
