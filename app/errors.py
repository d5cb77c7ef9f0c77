"""From errors to `application/problem+json` (RFC 9457); the only module that knows statuses."""

import logging
import re
from collections.abc import Iterator, Mapping
from http import HTTPStatus
from types import MappingProxyType
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.routing import Match

from app.request_id import current_id
from core import errors as core
from storage import errors as stored
from storage.formats import errors as formats

__all__ = [
    "ANY_BODY",
    "JSON_BODY",
    "READING",
    "STATUS",
    "WRITING",
    "BodyTooLarge",
    "DigestMismatch",
    "HostNotAllowed",
    "InternalError",
    "InvalidRequest",
    "KeyNeeded",
    "KeyRefused",
    "MalformedBody",
    "MalformedUpload",
    "MethodNotAllowed",
    "NoSuchRoute",
    "Problem",
    "ScopeMissing",
    "TooManyRequests",
    "TooManyTracks",
    "TrackNotFound",
    "UnsupportedBody",
    "WorkerDied",
    "add_handlers",
    "internal_error",
    "problem_name",
    "problem_response",
    "problem_type",
    "problems",
]

MEDIA_TYPE = "application/problem+json"

_METHODS = ("DELETE", "GET", "HEAD", "PATCH", "POST", "PUT")
_MOST_FIELDS = 20  # a body of 100,000 poses may be wrong 700,000 times
_MOST_CHARACTERS = 200  # of what a client sent and an answer repeats

_log = logging.getLogger("tensormap")


class AppError(core.TensorMapError):
    """Base of the errors that only a service has.

    Attributes:
        headers: What the answer says besides, in its head.
    """

    headers: Mapping[str, str] = MappingProxyType({})


class InvalidRequest(AppError):
    """A parameter or JSON body that is not as the API describes it."""


class BodyTooLarge(AppError):
    """A body longer than the service reads."""


class UnsupportedBody(AppError):
    """A body of a type or encoding that this route does not take."""


class MalformedBody(AppError):
    """A compressed body that does not decompress."""


class DigestMismatch(AppError):
    """A body that is not what its Content-Digest says."""


class MalformedUpload(AppError):
    """A body of many scans that is no tar stream, or breaks off; what came before is stored."""


class KeyNeeded(AppError):
    """A request without a key, to a service that asks for one."""

    # RFC 6750: a request without a key is only told which scheme to use.
    headers = MappingProxyType({"WWW-Authenticate": "Bearer"})


class KeyRefused(AppError):
    """A key that this service does not know, or no longer."""

    headers = MappingProxyType({"WWW-Authenticate": 'Bearer error="invalid_token"'})


class ScopeMissing(AppError):
    """A key that does not allow what was asked for."""

    def __init__(self, detail: str, scopes: tuple[str, ...] = ()) -> None:
        super().__init__(detail)
        wanted = f', scope="{" ".join(scopes)}"' if scopes else ""
        self.headers = {"WWW-Authenticate": f'Bearer error="insufficient_scope"{wanted}'}


class TooManyRequests(AppError):
    """More requests than a key may make in this time; `Retry-After` says when it may again."""

    def __init__(self, detail: str, wait_s: int, headers: Mapping[str, str]) -> None:
        super().__init__(detail)
        self.headers = {"Retry-After": str(wait_s), **headers}


class HostNotAllowed(AppError):
    """A request that reached a service without keys by another name than this machine's."""


class NoSuchRoute(AppError):
    """A path that the API does not have."""


class MethodNotAllowed(AppError):
    """A method that this path does not have; `Allow` lists those that it has."""


class TrackNotFound(AppError):
    """A track that is not there, or no longer."""


class TooManyTracks(AppError):
    """A new track, while as many are kept as this service may."""


class WorkerDied(AppError):
    """The process of a build ended before the build did."""


class InternalError(AppError):
    """A fault of the service; its log says more."""


S = HTTPStatus
STATUS: dict[type[core.TensorMapError], HTTPStatus] = {
    core.InvalidScan: S.UNPROCESSABLE_ENTITY,
    core.TooFewReturns: S.UNPROCESSABLE_ENTITY,
    core.InvalidPose: S.UNPROCESSABLE_ENTITY,
    core.InvalidImage: S.UNPROCESSABLE_ENTITY,
    core.InvalidParameters: S.UNPROCESSABLE_ENTITY,
    core.InvalidMap: S.UNPROCESSABLE_ENTITY,
    core.InvalidSignature: S.UNPROCESSABLE_ENTITY,
    core.StaleSignature: S.CONFLICT,
    core.BasisMismatch: S.CONFLICT,
    core.UnknownDrive: S.NOT_FOUND,
    core.StaleObservation: S.CONFLICT,
    core.UnknownSegment: S.UNPROCESSABLE_ENTITY,
    core.SensorMismatch: S.UNPROCESSABLE_ENTITY,
    core.EmptyDrive: S.UNPROCESSABLE_ENTITY,
    core.Cancelled: S.CONFLICT,
    formats.EmptyBody: S.UNPROCESSABLE_ENTITY,
    formats.TruncatedScan: S.UNPROCESSABLE_ENTITY,
    formats.WrongDtype: S.UNPROCESSABLE_ENTITY,
    formats.MalformedScan: S.UNPROCESSABLE_ENTITY,
    formats.ScanTooLarge: S.REQUEST_ENTITY_TOO_LARGE,
    formats.UnknownFormat: S.UNSUPPORTED_MEDIA_TYPE,
    formats.UnknownDriveLayout: S.UNPROCESSABLE_ENTITY,
    formats.MalformedDrive: S.UNPROCESSABLE_ENTITY,
    stored.MapNotFound: S.NOT_FOUND,
    stored.DriveNotFound: S.NOT_FOUND,
    stored.ScanNotFound: S.NOT_FOUND,
    stored.RevisionNotFound: S.NOT_FOUND,
    stored.JobNotFound: S.NOT_FOUND,
    stored.KeyNotFound: S.NOT_FOUND,
    stored.MapExists: S.CONFLICT,
    stored.MapChanged: S.PRECONDITION_FAILED,
    stored.ScanConflict: S.CONFLICT,
    stored.DriveClosed: S.CONFLICT,
    stored.NoLiveRevision: S.CONFLICT,
    stored.RevisionIsLive: S.CONFLICT,
    stored.AmbiguousRevision: S.CONFLICT,
    stored.JobNotRunning: S.CONFLICT,
    stored.RequestKeyReused: S.CONFLICT,
    stored.InvalidSlug: S.UNPROCESSABLE_ENTITY,
    stored.CorruptFile: S.INTERNAL_SERVER_ERROR,
    stored.CorruptImages: S.INTERNAL_SERVER_ERROR,
    stored.StorageBusy: S.SERVICE_UNAVAILABLE,
    stored.StorageFull: S.INSUFFICIENT_STORAGE,
    stored.StorageReadOnly: S.SERVICE_UNAVAILABLE,
    stored.StorageUnavailable: S.SERVICE_UNAVAILABLE,
    stored.WrongCatalog: S.SERVICE_UNAVAILABLE,
    stored.DataDirInUse: S.SERVICE_UNAVAILABLE,
    InvalidRequest: S.UNPROCESSABLE_ENTITY,
    BodyTooLarge: S.REQUEST_ENTITY_TOO_LARGE,
    UnsupportedBody: S.UNSUPPORTED_MEDIA_TYPE,
    MalformedBody: S.BAD_REQUEST,
    DigestMismatch: S.BAD_REQUEST,
    MalformedUpload: S.UNPROCESSABLE_ENTITY,
    KeyNeeded: S.UNAUTHORIZED,
    KeyRefused: S.UNAUTHORIZED,
    ScopeMissing: S.FORBIDDEN,
    TooManyRequests: S.TOO_MANY_REQUESTS,
    HostNotAllowed: S.MISDIRECTED_REQUEST,
    NoSuchRoute: S.NOT_FOUND,
    MethodNotAllowed: S.METHOD_NOT_ALLOWED,
    TrackNotFound: S.NOT_FOUND,
    TooManyTracks: S.SERVICE_UNAVAILABLE,
    WorkerDied: S.INTERNAL_SERVER_ERROR,
    InternalError: S.INTERNAL_SERVER_ERROR,
}

READING = (stored.StorageBusy, stored.StorageUnavailable, InternalError)
"""How every route that reads the store may end."""
WRITING = (*READING, stored.StorageFull, stored.StorageReadOnly)
"""How every route that writes to it may end."""
ANY_BODY = (BodyTooLarge, UnsupportedBody, MalformedBody, DigestMismatch)
"""How every route that reads a body may end."""
JSON_BODY = (InvalidRequest, *ANY_BODY)
"""How every route that takes JSON may end."""


class FieldProblem(BaseModel):
    """One thing that is wrong with a request."""

    where: str = Field(description="Path to it, as `body/ranks/0` or `query/k`.")
    what: str = Field(description="What was wanted.")


class Problem(BaseModel):
    """An error, as RFC 9457 writes it."""

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
    title: str = Field(description="What it means, the same for every error of this type.")
    status: int
    detail: str = Field(description="What was wanted and what came, this time.")
    errors: list[FieldProblem] | None = None
    request_id: str | None = Field(
        None, description="Of the request, as in `X-Request-Id` and in the service's log."
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


def _name_of(error: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "-", error).lower()


def problems(*kinds: type[core.TensorMapError]) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI `responses` of a route that may end in these errors."""
    by_status: dict[HTTPStatus, list[type[core.TensorMapError]]] = {}
    for kind in dict.fromkeys(kinds):
        by_status.setdefault(STATUS[kind], []).append(kind)
    return {
        status.value: {
            "description": "; ".join(f"`{problem_name(kind)}`: {_title(kind)}" for kind in of_it),
            "content": {
                MEDIA_TYPE: {
                    "schema": {"$ref": "#/components/schemas/Problem"},
                    "examples": {
                        problem_name(kind): {
                            "value": {
                                "type": problem_type(kind.__name__),
                                "title": _title(kind),
                                "status": status.value,
                                "detail": "what was wanted and what came",
                            }
                        }
                        for kind in of_it
                    },
                }
            },
        }
        for status, of_it in sorted(by_status.items())
    }


def problem_response(
    error: core.TensorMapError, errors: list[dict[str, str]] | None = None
) -> JSONResponse:
    """Answer with an error."""
    kind = next(kind for kind in type(error).__mro__ if kind in STATUS)
    status = STATUS[kind]
    content: dict[str, Any] = {
        "type": problem_type(kind.__name__),
        "title": _title(kind),
        "status": status.value,
        "detail": str(error),
    }
    if errors is not None:
        content["errors"] = errors
    if (request_id := current_id()) is not None:
        content["request_id"] = request_id
    headers = error.headers if isinstance(error, AppError) else None
    return JSONResponse(content, status, headers, media_type=MEDIA_TYPE)


def add_handlers(app: FastAPI) -> None:
    """Make every error of the service a problem."""

    @app.exception_handler(core.TensorMapError)
    def known(request: Request, error: core.TensorMapError) -> JSONResponse:
        response = problem_response(error)
        if response.status_code >= S.INTERNAL_SERVER_ERROR:
            _log.error("%s %s: %s", request.method, request.url.path, error, exc_info=error)
        return response

    @app.exception_handler(RequestValidationError)
    def invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        kind = request.headers.get("content-type", "")
        # FastAPI parses as JSON only what says that it is, and else finds bytes for a body.
        if "json" not in kind.lower() and any(e["loc"] == ("body",) for e in error.errors()):
            return problem_response(
                UnsupportedBody(f"Content-Type is {kind[:80]!r}, wanted application/json")
            )
        fields = list(_field_problems(error))
        more = len(error.errors()) - len(fields)
        detail = "; ".join(f"{field['where']}: {field['what']}" for field in fields)
        return problem_response(
            InvalidRequest(f"{detail}; and {more} more" if more else detail), fields
        )

    @app.exception_handler(HTTPException)
    def http(request: Request, error: HTTPException) -> JSONResponse:
        if isinstance(error.__cause__, core.TensorMapError):  # met while the body was read
            return problem_response(error.__cause__)
        if error.status_code == S.REQUEST_ENTITY_TOO_LARGE:
            return problem_response(BodyTooLarge(str(error.detail)))
        path = request.url.path[:_MOST_CHARACTERS]
        if error.status_code == S.NOT_FOUND:
            return problem_response(NoSuchRoute(f"there is no {path}; see /docs"))
        if error.status_code == S.METHOD_NOT_ALLOWED:
            allowed = ", ".join(_allowed_methods(request))
            response = problem_response(
                MethodNotAllowed(f"{path} has no {request.method[:40]}, it has {allowed}")
            )
            response.headers["Allow"] = allowed
            return response
        return problem_response(InvalidRequest(str(error.detail)))

    @app.exception_handler(ClientDisconnect)
    def gone(request: Request, _error: ClientDisconnect) -> Response:
        # A vehicle drove out of reach: nobody reads the answer, and it is no fault of the service.
        _log.info("%s %s: the client went away", request.method, request.url.path)
        return Response(status_code=S.BAD_REQUEST)


def internal_error(error: Exception) -> JSONResponse:
    """Answer with a fault of ours: its traceback is in the log, under the request's id."""
    _log.error("a fault of the service", exc_info=error)
    return problem_response(InternalError("the service failed; its log says where"))


def _allowed_methods(request: Request) -> list[str]:
    # Starlette's own Allow has the methods of the first route only, and ours have one each.
    return [
        method
        for method in _METHODS
        if any(
            route.matches({**request.scope, "method": method})[0] is Match.FULL
            for route in request.app.routes
        )
    ]


def _field_problems(error: RequestValidationError) -> Iterator[dict[str, str]]:
    for found in error.errors()[:_MOST_FIELDS]:
        where = "/".join(str(part) for part in found["loc"])
        yield {"where": where[:_MOST_CHARACTERS], "what": str(found["msg"])[:_MOST_CHARACTERS]}


def _title(kind: type[core.TensorMapError]) -> str:
    return (kind.__doc__ or "").strip().splitlines()[0]
