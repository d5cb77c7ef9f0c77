"""The parameters of a route without FastAPI's solver, which takes longer than most answers.

FastAPI walks the tree of dependencies on each request. Here it is walked once; what is not as
simple as our routes are is left to FastAPI, and so is every error.
"""

from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

from fastapi import Request, Response
from fastapi._compat import ModelField, field_annotation_is_sequence
from fastapi.dependencies.models import Dependant
from fastapi.dependencies.utils import request_params_to_args
from pydantic import BaseModel, ValidationError
from starlette.datastructures import QueryParams

from app.http.bodies.bodies import BodyReader

_Read = Callable[[Request], Awaitable[Any]]

_known: dict[Callable[..., Any], _Read | None] = {}


def known(dependency: Callable[..., Any], read: _Read | None = None) -> None:
    """Note what a dependency returns for a request; without `read` it only declares something."""
    _known[dependency] = read


class Unsolvable(Exception):
    """FastAPI has to solve the parameters of this route, or of this request."""


class Solver:
    """Reads the parameters of one route.

    Args:
        dependant: The route's, as FastAPI found it.

    Raises:
        Unsolvable: If the route has parameters of other kinds.
    """

    def __init__(self, dependant: Dependant) -> None:
        if dependant.cookie_params or dependant.body_params or dependant.request_param_name:
            raise Unsolvable
        self._sort_fields(dependant)
        self._sort_dependencies(dependant)
        self._response_name = dependant.response_param_name
        self._without_query = {} if not dependant.query_params else self._defaults(dependant)

    def _sort_fields(self, dependant: Dependant) -> None:
        """Sort the parameters of path, query and head by how they are read."""
        self._texts: list[tuple[str, str, str]] = []
        self._models: list[tuple[str, type[BaseModel]]] = []
        self._params: list[tuple[list[ModelField], str]] = []
        for fields, source in (
            (dependant.path_params, "path_params"),
            (dependant.query_params, "query_params"),
            (dependant.header_params, "headers"),
        ):
            texts = [field for field in fields if source != "query_params" and _is_text(field)]
            self._texts += [(field.name, source, field.alias) for field in texts]
            if source == "query_params" and len(fields) == 1 and (model := _plain_model(fields[0])):
                self._models.append((fields[0].name, model))
            elif others := [field for field in fields if field not in texts]:
                self._params.append((others, source))

    def _sort_dependencies(self, dependant: Dependant) -> None:
        """Sort the dependencies by what is done with them; reject those that are not known."""
        self._checks: list[_Read] = []
        self._read: dict[str, _Read] = {}
        self._bodies: dict[str, Callable[[Request], Any]] = {}
        for dependency in dependant.dependencies:
            call, name = dependency.call, dependency.name
            if isinstance(call, BodyReader) and name is not None:
                self._bodies[name] = asynccontextmanager(call.__call__)
            elif call is None or call not in _known:
                raise Unsolvable
            elif (read := _known[call]) is None:
                continue
            elif name is None:
                self._checks.append(read)
            else:
                self._read[name] = read

    @staticmethod
    def _defaults(dependant: Dependant) -> dict[str, Any] | None:
        """Return the parameters of an empty query, `None` if one is required."""
        values, errors = request_params_to_args(dependant.query_params, QueryParams())
        return None if errors else values

    async def solve(self, request: Request, stack: AsyncExitStack) -> dict[str, Any]:
        """Return the parameters of a request.

        Args:
            request: The request.
            stack: The stack of what is released after the answer.

        Raises:
            Unsolvable: If one is invalid; nothing of the body is read.
        """
        for check in self._checks:
            await check(request)
        values: dict[str, Any] = {
            name: getattr(request, source).get(alias) for name, source, alias in self._texts
        }
        has_query = bool(request.scope["query_string"])
        if not has_query:
            if self._without_query is None:
                raise Unsolvable
            values |= self._without_query
        for name, model in self._models if has_query else ():
            try:
                values[name] = model.model_validate(dict(request.query_params))
            except ValidationError:
                raise Unsolvable from None
        for fields, source in self._params:
            if source == "query_params" and not has_query:
                continue
            found, errors = request_params_to_args(fields, getattr(request, source))
            if errors:
                raise Unsolvable
            values |= found
        for name, read in self._read.items():
            values[name] = await read(request)
        if self._response_name is not None:
            values[self._response_name] = _empty_response()
        for name, reader in self._bodies.items():
            values[name] = await stack.enter_async_context(reader(request))
        return values


def _is_text(field: ModelField) -> bool:
    """Return whether a parameter is any text, or none by default: there is nothing to validate."""
    info = field.field_info
    optional = info.annotation == str | None and info.default is None and not info.is_required()
    return not info.metadata and (optional or (info.annotation is str and info.is_required()))


def _plain_model(field: ModelField) -> type[BaseModel] | None:
    """Return the model of a whole query if each of its fields has one value at most.

    FastAPI looks at the type of each field on each request, which takes longer than all the rest.
    """
    model = field.field_info.annotation
    if not (isinstance(model, type) and issubclass(model, BaseModel)):
        return None
    if model.model_config.get("extra") or any(
        field_annotation_is_sequence(of.annotation) or of.validation_alias not in {None, of.alias}
        for of in model.model_fields.values()
    ):
        return None
    return model


def _empty_response() -> Response:
    """Return what a route may set the status and the head of its answer in."""
    response = Response()
    del response.headers["content-length"]
    response.status_code = None  # type: ignore[assignment]  # that of the route
    return response
