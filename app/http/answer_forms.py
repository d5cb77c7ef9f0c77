"""The forms of an answer: JSON of all fields, JSON of some, or packed."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any, Self, TypeVar

from fastapi import Header, Response
from pydantic import BaseModel

from app.http.accepted import is_preferred
from app.http.answer_fields import included
from app.http.errors import InvalidRequest

PART_TYPE = "application/vnd.tensormap.part+json"
Accept = Annotated[str | None, Header(include_in_schema=False)]

M = TypeVar("M", bound=BaseModel)


@dataclass(frozen=True)
class PackedType:
    """The type of packed answers; docs/reference/http-api.md has the layouts.

    Attributes:
        media_type: As in `Accept`.
        bytes: Size of each answer.
    """

    media_type: str
    bytes: int

    def responses(self, what: str) -> dict[int | str, dict[str, Any]]:
        """Return the OpenAPI `responses` of a route that answers in these forms too."""
        packed = {
            "type": "string",
            "format": "binary",
            "description": f"On `Accept: {self.media_type}`: {self.bytes} bytes an answer,"
            " docs/reference/http-api.md.",
        }
        content = part_responses(what)[200]["content"]
        return {200: {"content": {**content, self.media_type: {"schema": packed}}}}


def part_responses(what: str) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI `responses` of a route that answers with some fields too."""
    part = {
        "type": "object",
        "description": f"With `fields`: these fields of {what}, no others.",
    }
    return {200: {"content": {PART_TYPE: {"schema": part}}}}


@dataclass(frozen=True)
class Form:
    """The form of an answer that a request asks for.

    Attributes:
        packed_as: The type if it is packed, else `None`.
        fields: As pydantic's `include`; all if `None`.
    """

    packed_as: str | None = None
    fields: dict[str, Any] | None = None

    @classmethod
    def part(cls, answer: type[BaseModel], fields: str | None) -> Self:
        """Return the form for a `fields` that was checked."""
        return cls(fields=None if fields is None else included(fields, answer))

    @classmethod
    def of(
        cls, answer: type[BaseModel], packed: PackedType, fields: str | None, accept: str | None
    ) -> Self:
        """Return the form for a `fields` that was checked, and the header `Accept`.

        Raises:
            InvalidRequest: If both came: a packed answer has the same fields always.
        """
        if not is_preferred(packed.media_type, accept):
            return cls.part(answer, fields)
        if fields is not None:
            raise InvalidRequest(
                f"fields came with a request for {packed.media_type}, which has the same fields"
                " always: wanted one of both"
            )
        return cls(packed.media_type)

    def shows(self, field: str) -> bool:
        """Return whether an answer in this form has a field; no packed one has it."""
        return not self.packed_as and (self.fields is None or field in self.fields)

    def of_each(self, items: str) -> Self:
        """Return the form of an answer whose field `items` is a list of answers in this form."""
        return (
            self if self.fields is None else replace(self, fields={items: {"__all__": self.fields}})
        )

    def content(self, whole: Callable[[], BaseModel], packed: Callable[[], bytes]) -> str | bytes:
        """Return an answer in this form, as text if it is JSON."""
        return packed() if self.packed_as else self._json(whole())

    def response(self, whole: Callable[[], M], packed: Callable[[], bytes]) -> M | Response:
        """Return an answer as a route returns it."""
        if self.packed_as:
            return Response(packed(), media_type=self.packed_as)
        return self.json_response(whole())

    def json_response(self, whole: M) -> M | Response:
        """Return an answer, which is not packed, as a route returns it."""
        if self.fields is None:
            return whole
        return Response(self._json(whole), media_type=PART_TYPE)

    def _json(self, whole: BaseModel) -> str:
        return whole.model_dump_json(include=self.fields)
