"""Request bodies: which are read, how they are checked, and how a route takes one."""

import re
from collections.abc import AsyncIterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Generic, TypeVar

from fastapi import Depends, Header, Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from app.access.access import Access
from app.http.bodies.content_digest import ContentDigest
from app.http.bodies.content_encoding import decoder_of
from app.http.bodies.incoming import Incoming, Limits
from app.http.bodies.json_body import read_json
from app.http.bodies.pace import Pace
from app.http.bodies.spool import Spool
from app.http.context import RequestContext, context_of
from app.http.errors import BodyTooLarge, UnsupportedBody
from app.http.openapi import reference
from app.http.problems import problem_response
from app.settings import Settings
from core.errors import TensorMapError
from storage.formats.scans.registry import SCAN_FORMATS

M = TypeVar("M", bound=BaseModel)
T = TypeVar("T")

_MANY_SCANS = re.compile(r"/v1/maps/[^/]+/drives/[^/]+/scans")
_JSON = re.compile(r"application/(json|[^;\s]+\+json)")

ContentType = Annotated[str | None, Header(include_in_schema=False)]


class BodyGuard:
    """Prepare to read a body; refuse one that is too long at once if it says so.

    FastAPI's own `max_body_size` answers in plain text; an error of ours is a problem.
    """

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._settings = settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on; nothing of its body is read before the route wants it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        context = context_of(scope)
        try:
            context.body = self._incoming(scope, context, Headers(scope=scope), receive)
        except TensorMapError as error:
            await problem_response(error)(scope, receive, send)
            return
        await self._app(scope, receive, send)

    def _incoming(
        self, scope: Scope, context: RequestContext, headers: Headers, receive: Receive
    ) -> Incoming:
        """Return the body that is to come.

        Raises:
            UnsupportedBody: If it is packed as we cannot unpack.
            DigestMismatch: If its digest cannot be read.
            BodyTooLarge: If it says that it is too long.
            TooManyRequests: If it says that it has more than its sender may send.
        """
        decoder = decoder_of(headers.get("content-encoding", ""))
        digest = ContentDigest(headers.get("content-digest", ""))
        limits = self._limits(scope, headers, packed=decoder is not None)
        declared = headers.get("content-length", "")
        if declared.isdecimal() and int(declared) > limits.sent:
            raise BodyTooLarge(f"the body has {declared} bytes, at most {limits.sent} are read")
        service = scope["app"].state.service
        access: Access = service.access
        if declared.isdecimal():
            access.spend_bytes(context, int(declared), announced=True)
        return Incoming(
            receive,
            limits=limits,
            decoder=decoder,
            digest=digest,
            pace=Pace(self._settings),
            spend=partial(access.spend_bytes, context),
            room=service.spool_room,
            key=context.sender,
        )

    def _limits(self, scope: Scope, headers: Headers, *, packed: bool) -> Limits:
        chosen = self._settings
        if scope["method"] == "POST" and _MANY_SCANS.fullmatch(scope["path"]):
            return Limits(chosen.max_upload_bytes, chosen.max_upload_bytes)
        sent = chosen.max_body_bytes
        unpacked = chosen.max_decoded_bytes if packed else sent
        if "json" in headers.get("content-type", "").lower():
            return Limits(min(chosen.max_json_bytes, sent), min(chosen.max_json_bytes, unpacked))
        return Limits(sent, unpacked)


class Received(Generic[T]):
    """A body that came whole and waits for a thread to open it."""

    def __init__(self, incoming: Incoming, spool: Spool) -> None:
        self._incoming, self._spool = incoming, spool

    def __len__(self) -> int:
        return len(self._spool)

    @property
    def packed(self) -> bool:
        """Whether it must be unpacked."""
        return self._incoming.packed

    def read(self) -> bytes:
        """Return its bytes, unpacked.

        Raises:
            MalformedBody: If it does not unpack.
            BodyTooLarge: If it unpacks to more than may be.
        """
        return b"".join(self._incoming.unpacked(self._spool.pieces()))

    def open(self) -> Any:  # noqa: ANN401 - what a route takes
        """Return what a route takes: here the bytes."""
        return self.read()


class ReceivedJson(Received[M]):
    """A body of JSON that came whole."""

    def __init__(self, incoming: Incoming, spool: Spool, model: type[M]) -> None:
        super().__init__(incoming, spool)
        self._model = model

    def open(self) -> M:
        """Return what the JSON says.

        Raises:
            RequestValidationError: If it is not as the API describes it.
        """
        return read_json(self.read(), self._model)


def incoming_of(request: Request) -> Incoming:
    """Return the body of a request, of which nothing is read before it is wanted."""
    body = context_of(request.scope).body
    if body is None:  # `BodyGuard` is not there
        raise LookupError("the body of this request was not prepared")
    return body


async def _received(request: Request) -> AsyncIterator[Received[bytes]]:
    incoming = incoming_of(request)
    async with incoming.spool() as spool:
        await incoming.fill(spool)
        yield Received(incoming, spool)


class JsonFrom(Generic[M]):
    """The dependency that reads a JSON body; the pool's thread parses and validates it.

    FastAPI does both on the event loop, where 4 MB of JSON hold everybody up for seconds.
    """

    def __init__(self, model: type[M]) -> None:
        self.model = model

    async def __call__(self, request: Request) -> AsyncIterator[ReceivedJson[M]]:
        """Give the body once it came whole."""
        incoming = incoming_of(request)
        kind = request.headers.get("content-type", "")
        if _JSON.match(kind.strip().lower()) is None:
            # Before it is read: a foreign page may send what says that it is text.
            raise UnsupportedBody(f"Content-Type is {kind[:80]!r}, wanted application/json")
        async with incoming.spool() as spool:
            await incoming.fill(spool)
            if not len(spool):
                raise RequestValidationError(
                    [{"type": "missing", "loc": ("body",), "msg": "Field required", "input": None}]
                )
            yield ReceivedJson(incoming, spool, self.model)


# The pool gives a route's function the bytes, or what the JSON says, for what waits.
Body = Annotated[bytes, Depends(_received)]
AsItComes = Annotated[Incoming, Depends(incoming_of)]
if TYPE_CHECKING:
    Json = Annotated[T, ...]
else:

    class Json:
        """`Json[MapIn]` is a parameter that takes the request's JSON body."""

        def __class_getitem__(cls, model: type[BaseModel]) -> Any:  # noqa: ANN401
            return Annotated[model, Depends(JsonFrom(model))]


def media_type(content_type: str | None) -> str:
    """Return a Content-Type without its parameters, lower case, empty if there is none."""
    return (content_type or "").partition(";")[0].strip().lower()


def described_body(
    binary: Mapping[str, str], json: type[BaseModel] | None = None
) -> dict[str, Any]:
    """Return the `openapi_extra` of a route that takes bodies of these media types, or JSON."""
    content: dict[str, Any] = (
        {} if json is None else {"application/json": {"schema": reference(json)}}
    )
    for name, text in binary.items():
        content[name] = {"schema": {"type": "string", "format": "binary", "description": text}}
    return {"requestBody": {"required": True, "content": content}}


SCAN_TYPES = {
    **{
        f.media_type: f"A scan as {f.name} ({' '.join(f.suffixes) or 'no suffix'})"
        for f in SCAN_FORMATS
    },
    "application/octet-stream": "A scan whose first bytes tell its format: "
    + ", ".join(f.name for f in SCAN_FORMATS if f.magics),
}
