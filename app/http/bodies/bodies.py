"""Request bodies: which are read, how they are checked, and how a route declares one."""

import re
from collections.abc import AsyncIterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from fastapi import Depends, Header, Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel
from starlette.datastructures import Headers
from starlette.types import Receive, Scope

from app.http.bodies.content_digest import ContentDigest
from app.http.bodies.content_encoding import decoder_of
from app.http.bodies.incoming import Incoming, Pace
from app.http.bodies.json_body import read_json
from app.http.bodies.spool import Spool
from app.http.context import context_of
from app.http.errors import BodyTooLarge, UnsupportedBody
from app.http.openapi import reference
from app.settings import Settings
from storage.formats.scans.registry import SCAN_FORMATS

T = TypeVar("T")

_MANY_SCANS = re.compile(r"/v1/maps/[^/]+/drives/[^/]+/scans")
_CAPTURE_PART = re.compile(r"/v1/maps/[^/]+/drives/[^/]+/captures/[^/]+/parts/[^/]+")
LARGEST_PART_BYTES = 16 * 2**20
"""Largest part of a capture, as sent and decompressed."""
_JSON = re.compile(r"application/(json|\S+\+json)")

ContentType = Annotated[str | None, Header(include_in_schema=False)]


def prepared_body(scope: Scope, receive: Receive) -> Incoming:
    """Return the body of a request before anything of it is read.

    Raises:
        UnsupportedBody: If its compression is unknown.
        DigestMismatch: If its digest cannot be parsed.
        BodyTooLarge: If its Content-Length is too large.
        TooManyRequests: If its Content-Length exceeds the quota of its sender.
    """
    service = scope["app"].state.service
    headers, context = Headers(scope=scope), context_of(scope)
    decoder = decoder_of(headers.get("content-encoding", ""))
    digest = ContentDigest(headers.get("content-digest", ""))
    sent, unpacked = _limits(service.settings, scope, headers, packed=decoder is not None)
    declared = headers.get("content-length", "")
    if declared.isdecimal():
        if int(declared) > sent:
            raise BodyTooLarge(f"the body has {declared} bytes, at most {sent} are read")
        service.access.require_quota(context, int(declared))
    return Incoming(
        receive,
        sent_limit=sent,
        unpacked_limit=unpacked,
        decoder=decoder,
        digest=digest,
        pace=Pace(service.settings),
        spend=partial(service.access.spend_bytes, context),
        room=service.spool_room,
        key=context.sender,
        give_way=service.pools.quiet,
    )


def _limits(settings: Settings, scope: Scope, headers: Headers, *, packed: bool) -> tuple[int, int]:
    """Return the largest body in bytes, as sent and decompressed."""
    if scope["method"] == "POST" and _MANY_SCANS.fullmatch(scope["path"]):
        return settings.max_upload_bytes, settings.max_upload_bytes
    if scope["method"] == "PUT" and _CAPTURE_PART.fullmatch(scope["path"]):
        largest = min(LARGEST_PART_BYTES, settings.max_body_bytes)
        return largest, largest
    sent = settings.max_body_bytes
    unpacked = settings.max_decoded_bytes if packed else sent
    if "json" in headers.get("content-type", "").lower():
        return min(settings.max_json_bytes, sent), min(settings.max_json_bytes, unpacked)
    return sent, unpacked


class Received:
    """A complete body, which a thread opens.

    Args:
        incoming: The body.
        spool: The body's bytes.
        model: The model of the body's JSON; `None` if the route takes the bytes.
    """

    def __init__(self, incoming: Incoming, spool: Spool, model: type[BaseModel] | None) -> None:
        self._incoming, self._spool, self._model = incoming, spool, model

    def __len__(self) -> int:
        return len(self._spool)

    @property
    def packed(self) -> bool:
        """Whether it is compressed."""
        return self._incoming.packed

    def open(self) -> Any:  # noqa: ANN401 - bytes, or the model
        """Return its decompressed bytes, or its JSON as the model.

        Raises:
            MalformedBody: If it cannot be decompressed.
            BodyTooLarge: If it is too long when decompressed.
            RequestValidationError: If its JSON is not as the API describes it.
        """
        body = b"".join(self._incoming.unpacked(self._spool.pieces()))
        return body if self._model is None else read_json(body, self._model)


def incoming_of(request: Request) -> Incoming:
    """Return the body of a request, of which nothing is read until the route reads it."""
    body = context_of(request.scope).body
    if body is None:  # `Admission` is not installed
        raise LookupError("the body of this request was not prepared")
    return body


class BodyReader:
    """The dependency that receives a body; the pool's thread parses and validates its JSON.

    FastAPI does both on the event loop, which 4 MB of JSON block for seconds.

    Args:
        model: The model of the JSON; `None` if the route takes bytes.
    """

    def __init__(self, model: type[BaseModel] | None = None) -> None:
        self.model = model

    async def __call__(self, request: Request) -> AsyncIterator[Received]:
        """Yield the body when it is complete."""
        incoming = incoming_of(request)
        kind = request.headers.get("content-type", "")
        if self.model is not None and _JSON.fullmatch(media_type(kind)) is None:
            # Before it is read: pages of other sites may send JSON as text without permission.
            raise UnsupportedBody(f"Content-Type is {kind[:80]!r}, wanted application/json")
        with incoming.spool() as spool:
            await incoming.fill(spool)
            if self.model is not None and not len(spool):
                raise RequestValidationError(
                    [{"type": "missing", "loc": ("body",), "msg": "Field required", "input": None}]
                )
            yield Received(incoming, spool, self.model)


# The pool calls a route's function with the bytes, or the parsed JSON, of what was received.
Body = Annotated[bytes, Depends(BodyReader())]
AsItComes = Annotated[Incoming, Depends(incoming_of)]
if TYPE_CHECKING:
    Json = Annotated[T, ...]
else:

    class Json:
        """`Json[MapIn]` is a parameter that takes the request's JSON body."""

        def __class_getitem__(cls, model: type[BaseModel]) -> Any:  # noqa: ANN401
            return Annotated[model, Depends(BodyReader(model))]


def media_type(content_type: str | None) -> str:
    """Return a Content-Type without its parameters, lower case, empty if there is none."""
    return (content_type or "").partition(";")[0].strip().lower()


def required_type(content_type: str | None, *accepted: str) -> str:
    """Return the media type of a body.

    Raises:
        UnsupportedBody: If the type is not accepted.
    """
    kind = media_type(content_type)
    if kind not in accepted:
        wanted = " or ".join(filter(None, accepted))
        raise UnsupportedBody(f"Content-Type is {kind[:80]!r}, wanted {wanted}")
    return kind


def described_body(
    binary: Mapping[str, str], json: type[BaseModel] | None = None
) -> dict[str, Any]:
    """Return the `openapi_extra` of a route that takes bodies of these media types, or JSON."""
    content: dict[str, Any] = {
        name: {"schema": {"type": "string", "format": "binary", "description": text}}
        for name, text in binary.items()
    }
    if json is not None:
        content = {"application/json": {"schema": reference(json)}, **content}
    return {"requestBody": {"required": True, "content": content}}


SCAN_TYPES = {
    **{
        f.media_type: f"A scan as {f.name} ({' '.join(f.suffixes) or 'no suffix'})"
        for f in SCAN_FORMATS
    },
    "application/octet-stream": "A scan whose format is detected by its first bytes: "
    + ", ".join(f.name for f in SCAN_FORMATS if f.magics),
}
