"""Errors as `application/problem+json` (RFC 9457)."""

import logging
import re
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.routing import Match

from app.http import errors as own
from app.http.answer_headers import ALLOW
from app.http.bodies.bodies import media_type
from app.http.client import LEFT
from app.http.context import context_of, current_context, logged_path
from app.http.field_problems import field_problems
from app.http.openapi import reference
from core import errors as core
from storage.errors import with_cause
from storage.formats.errors import MalformedScan, TruncatedScan, UnknownFormat, WrongDtype

MEDIA_TYPE = "application/problem+json"

_METHODS = ("DELETE", "GET", "HEAD", "PATCH", "POST", "PUT")
_OF_FILES = ("GET", "HEAD")  # of the documentation's pages, whose application refuses by itself
_MOST_CHARACTERS = 200  # of the client's text in an answer

_log = logging.getLogger("tensormap")


class FieldProblem(BaseModel):
    """One thing that is wrong with a request."""

    where: str = Field(description="Path to the field, for example `body/ranks/0` or `query/k`.")
    what: str = Field(description="What was wanted and what was received.")


class SetAsideOut(BaseModel):
    """A file of an upload that was not stored."""

    file: str = Field(description="The file's name in the archive.")
    type: str = Field(description="The stable name of the error.")
    detail: str = Field(description="What was wanted and what was received.")


class Problem(BaseModel):
    """An error, as in RFC 9457."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "type": "/problems/map-not-found",
                "title": "A map that is not there.",
                "status": 404,
                "detail": "there is no map 'campus'",
            }
        }
    )

    type: str = Field(description="Stable name of the error; the path explains it.")
    title: str = Field(description="What the error means, the same for every error of this type.")
    status: int
    detail: str = Field(description="What was wanted and what was received, in this case.")
    errors: list[FieldProblem] | None = None
    set_aside: list[SetAsideOut] | None = Field(
        None,
        description="The files that were not stored, with reasons, the first thousand; for"
        " `nothing-stored`.",
    )
    request_id: str | None = Field(
        None, description="Id of the request, as in `X-Request-Id` and in the service's log."
    )


_FORM = "application/x-www-form-urlencoded"
_PARTS = "multipart/form-data"
_JSON = "application/json"
_OF_FORMS = (
    "; curl -d sends a file as a form, without its line breaks: wanted --data-binary or -T, and"
    " -H 'Content-Type: ...'"
)
_OF_PARTS = (
    "; a form is not read, as curl -F sends one: wanted the file itself, with --data-binary or -T,"
    " and -H 'Content-Type: ...'"
)
_OF_CURL = (
    "; curl -d removes line breaks and zero bytes from a file: was it sent so? Wanted --data-binary"
    " or -T"
)
_OF_KINDS = {_FORM: _OF_FORMS, _PARTS: _OF_PARTS}
_OF_TYPES = (own.UnsupportedBody, UnknownFormat)  # every route that takes a body checks its type
_OF_CONTENTS = (
    core.InvalidImage,
    core.InvalidPose,
    core.InvalidSignature,
    own.MalformedUpload,
    MalformedScan,
    TruncatedScan,
    WrongDtype,
)


def problem_name(error: type[core.TensorMapError]) -> str:
    """Return an error's stable name.

    Examples:
        >>> problem_name(core.TooFewReturns)
        'too-few-returns'
    """
    return _name_of(error.__name__)


def problem_type(error: str) -> str:
    """Return the `type` of the error class called `error`: the path that explains it.

    Examples:
        >>> problem_type("EmptyDrive")
        '/problems/empty-drive'
    """
    return f"/problems/{_name_of(error)}"


def problem_title(kind: type[core.TensorMapError]) -> str:
    """Return the meaning of an error, the first line of its docstring."""
    return (kind.__doc__ or "").strip().splitlines()[0]


def _problem(kind: type[core.TensorMapError], detail: str) -> dict[str, Any]:
    return {
        "type": problem_type(kind.__name__),
        "title": problem_title(kind),
        "status": own.STATUS[kind].value,
        "detail": detail,
    }


def _name_of(error: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "-", error).lower()


def problems(*kinds: type[core.TensorMapError]) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI `responses` of a route that may end in these errors."""
    by_status: dict[HTTPStatus, list[type[core.TensorMapError]]] = {}
    for kind in dict.fromkeys(kinds):
        by_status.setdefault(own.STATUS[kind], []).append(kind)
    return {
        status.value: _response(
            "; ".join(f"`{problem_name(kind)}`: {problem_title(kind)}" for kind in of_status),
            {
                problem_name(kind): {"value": _problem(kind, "wanted this, got that")}
                for kind in of_status
            },
        )
        for status, of_status in sorted(by_status.items())
    }


def _response(description: str, examples: dict[str, Any]) -> dict[str, Any]:
    content = {"schema": reference(Problem), "examples": examples}
    return {"description": description, "content": {MEDIA_TYPE: content}}


def with_problems(
    responses: dict[int | str, dict[str, Any]], *kinds: type[core.TensorMapError]
) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI `responses` of a route that may end in these errors too.

    FastAPI itself leaves out what a router describes of a status that the route has errors of.
    """
    described = {
        name
        for answer in responses.values()
        for name in answer.get("content", {}).get(MEDIA_TYPE, {}).get("examples", ())
    }
    added = problems(*(kind for kind in kinds if problem_name(kind) not in described))
    found = {**added, **responses}
    for status in added.keys() & responses.keys():
        both = responses[status], added[status]
        examples = [answer["content"][MEDIA_TYPE]["examples"] for answer in both]
        description = "; ".join(answer["description"] for answer in both)
        found[status] = _response(description, examples[0] | examples[1])
    return found


def _kind_of(error: core.TensorMapError) -> type[core.TensorMapError]:
    """Return the class of an error that has a status: its own, or a base."""
    return next(kind for kind in type(error).__mro__ if kind in own.STATUS)


def problem_response(
    error: core.TensorMapError, errors: list[dict[str, str]] | None = None, hint: str = ""
) -> JSONResponse:
    """Return an error as an answer, with a hint behind its text."""
    content = _problem(_kind_of(error), f"{error}{hint}")
    if errors is not None:
        content["errors"] = errors
    if (context := current_context()) is not None:
        content["request_id"] = context.request_id
        context.problem = problem_name(_kind_of(error))
    headers = None
    if isinstance(error, own.AppError):
        headers = error.headers
        content.update(error.more)
    return JSONResponse(content, content["status"], headers, media_type=MEDIA_TYPE)


def is_failure(error: core.TensorMapError) -> bool:
    """Return whether an error is a failure of the service or of its storage.

    A limit that is reached is none: a client in a loop reaches it as often as it likes.
    """
    status = own.STATUS[_kind_of(error)]
    is_limit = isinstance(error, own.AppError) and status is HTTPStatus.SERVICE_UNAVAILABLE
    return status >= HTTPStatus.INTERNAL_SERVER_ERROR and not is_limit


def log_failure(log: logging.Logger, what: str, error: core.TensorMapError) -> None:
    """Log an error with its cause if it is a failure of the service or of its storage.

    It has no trace: a full disk, or a damaged file that is named, needs none.
    """
    if is_failure(error):
        log.error("%s: %s", what, with_cause(error))


def add_handlers(app: FastAPI) -> None:
    """Answer every error of the service with a problem.

    The handlers are asynchronous because a thread, as for plain functions, takes longer than they.
    """

    @app.exception_handler(core.TensorMapError)
    async def known(request: Request, error: core.TensorMapError) -> JSONResponse:
        log_failure(_log, f"{request.method} {logged_path(request.scope)}", error)
        return problem_response(error, hint=_hint(request, error))

    @app.exception_handler(RequestValidationError)
    async def invalid(_request: Request, error: RequestValidationError) -> JSONResponse:
        return invalid_response(error)

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> JSONResponse:
        path = request.url.path[:_MOST_CHARACTERS]
        if error.status_code == HTTPStatus.NOT_FOUND:
            return problem_response(own.NoSuchRoute(f"there is no {path}; see /docs"))
        if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
            allowed = ", ".join(_allowed_methods(request) or _OF_FILES)
            response = problem_response(
                own.MethodNotAllowed(f"{path} has no {request.method[:40]}, it has {allowed}")
            )
            response.headers[ALLOW] = allowed
            return response
        return problem_response(own.InvalidRequest(str(error.detail)))

    @app.exception_handler(ClientDisconnect)
    async def gone(request: Request, _error: ClientDisconnect) -> Response:
        # For example a vehicle out of reach: nobody reads the answer, and it is no internal error.
        _log.info("%s %s: the client went away", request.method, logged_path(request.scope))
        return Response(status_code=LEFT)


def _hint(request: Request, error: core.TensorMapError) -> str:
    """Return what is wrong with a form, or may be with a body that `curl -d` sent."""
    kind = media_type(request.headers.get("content-type"))
    if kind in _OF_KINDS:
        return _OF_KINDS[kind] if isinstance(error, _OF_TYPES) else ""
    is_curl = request.headers.get("user-agent", "").startswith("curl/")
    if not is_curl or kind == _JSON or not isinstance(error, _OF_CONTENTS):
        return ""
    body = context_of(request.scope).body
    return _OF_CURL if body is not None and body.is_stripped else ""


def invalid_response(error: RequestValidationError) -> JSONResponse:
    """Return what is wrong with parameters or JSON as an answer."""
    fields = field_problems(error)
    more = len(error.errors()) - len(fields)
    detail = "; ".join(f"{field['where']}: {field['what']}" for field in fields)
    return problem_response(
        own.InvalidRequest(f"{detail}; and {more} more" if more else detail), fields
    )


def internal_error(error: Exception) -> JSONResponse:
    """Return an internal error as an answer; its traceback is logged with the request's id."""
    _log.error("a fault of the service", exc_info=error)
    return problem_response(own.InternalError("the service failed; its log says where"))


def _allowed_methods(request: Request) -> list[str]:
    # Starlette's own Allow has the methods of the first route only, and our routes have one each.
    return [
        method
        for method in _METHODS
        if any(
            route.matches({**request.scope, "method": method})[0] is Match.FULL
            for route in request.app.routes
        )
    ]
