"""Names in a query: those that a route does not have are rejected, as unknown fields of JSON are.

A mistyped prior or threshold would be none. So are numbers with underscores: pydantic reads `1_0`,
which JSON has not, as 10.
"""

from collections.abc import Iterator
from typing import Any, get_args

from fastapi import Request
from fastapi._compat import ModelField, field_annotation_is_sequence
from fastapi.dependencies.models import Dependant
from fastapi.dependencies.utils import _get_flat_fields_from_params
from fastapi.exceptions import RequestValidationError
from starlette.datastructures import QueryParams

from app.http.direct import known


class QueryNames:
    """The names of a route's query parameters, which may be repeated, and which are numbers.

    Args:
        dependant: The route's, as FastAPI found it.
    """

    def __init__(self, dependant: Dependant) -> None:
        fields = list(_query_fields(dependant))
        self._names = {field.alias for field in fields}
        self._repeatable = {
            field.alias
            for field in fields
            if field_annotation_is_sequence(field.field_info.annotation)
        }
        kinds = {field.alias: _number_in(field.field_info.annotation) for field in fields}
        self._numbers = {name: kind for name, kind in kinds.items() if kind is not None}
        names = ", ".join(sorted(self._names))
        self._unknown = "the route has no " + (
            f"such parameter, it has {names}" if names else "query"
        )

    def require(self, query: QueryParams) -> None:
        """Check the names of a query, and that its numbers have no underscores.

        Raises:
            RequestValidationError: If a name is unknown, or is repeated and is not a list, or a
                number is not one.
        """
        faults = []
        for name in query:
            if name not in self._names:
                faults.append((name, self._unknown))
            elif name not in self._repeatable and (times := len(query.getlist(name))) > 1:
                faults.append((name, f"wanted once, got {times} times"))
        errors: list[dict[str, Any]] = [
            {"type": "query_name", "loc": ("query", name), "msg": what} for name, what in faults
        ]
        errors += [
            {"type": f"{kind.__name__}_parsing", "loc": ("query", name), "msg": "", "input": text}
            for name, kind in self._numbers.items()
            for text in query.getlist(name)
            if "_" in text
        ]
        if errors:
            raise RequestValidationError(errors)


async def require_query_names(request: Request) -> None:
    """Check the names of a request's query against those of its route, a `PooledRoute`."""
    if request.scope["query_string"]:
        request.scope["route"].query_names.require(request.query_params)


def _query_fields(dependant: Dependant) -> Iterator[ModelField]:
    # A model of parameters counts as its fields.
    yield from _get_flat_fields_from_params(dependant.query_params)
    for dependency in dependant.dependencies:
        yield from _query_fields(dependency)


def _number_in(annotation: Any) -> type | None:  # noqa: ANN401 - of a parameter
    """Return `int` or `float` of a parameter that is one, or a list of them, `None` of others."""
    if annotation is int or annotation is float:
        return annotation
    return next(filter(None, map(_number_in, get_args(annotation))), None)


known(require_query_names, require_query_names)
