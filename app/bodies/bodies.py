"""Request bodies: which are read, how they are unpacked and checked, and what is not JSON."""

import re
from collections.abc import Callable, Iterator
from functools import partial
from typing import Annotated, Any

from fastapi import Depends, Header, Request
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.access.access import Access
from app.bodies.content_digest import ContentDigest
from app.bodies.content_encoding import Decoder, decoder_of
from app.errors import STATUS, BodyTooLarge
from app.problems import problem_response
from app.settings import Settings
from core.errors import TensorMapError
from storage.formats.registry import SCAN_FORMATS

__all__ = ["SCAN_BODY", "Body", "BodyGuard", "ContentType", "binary_body", "media_type"]

_MANY_SCANS = re.compile(r"/v1/maps/[^/]+/drives/[^/]+/scans")

ContentType = Annotated[str | None, Header(include_in_schema=False)]


class BodyGuard:
    """Unpack and check bodies on the way in; refuse one that is too long, at once if it says so.

    FastAPI's own `max_body_size` answers in plain text; an error of ours is a problem.
    """

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._settings = settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, its body within the limits."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        try:
            incoming = self._incoming(scope, headers, receive)
        except TensorMapError as error:
            await problem_response(error)(scope, receive, send)
            return
        await self._app(scope, incoming.receive, send)

    def _incoming(self, scope: Scope, headers: Headers, receive: Receive) -> "_Incoming":
        """Return the body that is to come.

        Raises:
            UnsupportedBody: If it is packed as we cannot unpack.
            DigestMismatch: If its digest cannot be read.
            BodyTooLarge: If it says that it is too long.
            TooManyRequests: If it says that it has more than its sender may send.
        """
        chosen = self._settings
        decoder = decoder_of(headers.get("content-encoding", ""))
        digest = ContentDigest(headers.get("content-digest", ""))
        sent_limit = chosen.max_body_bytes
        limit = sent_limit if decoder is None else chosen.max_decoded_bytes
        if "json" in headers.get("content-type", "").lower():
            sent_limit = min(chosen.max_json_bytes, sent_limit)
            limit = min(chosen.max_json_bytes, limit)
        if scope["method"] == "POST" and _MANY_SCANS.fullmatch(scope["path"]):
            sent_limit = limit = chosen.max_upload_bytes
        declared = headers.get("content-length", "")
        if declared.isdecimal() and int(declared) > sent_limit:
            raise BodyTooLarge(f"the body has {declared} bytes, at most {sent_limit} are read")
        access: Access = scope["app"].state.service.access
        if declared.isdecimal():
            access.spend_bytes(scope, int(declared), announced=True)
        spend = partial(access.spend_bytes, scope)
        return _Incoming(receive, sent_limit, limit, decoder, digest, spend)


class _Incoming:
    """A body on its way in."""

    def __init__(
        self,
        receive: Receive,
        sent_limit: int,
        limit: int,
        decoder: Decoder | None,
        digest: ContentDigest,
        spend: Callable[[int], None],
    ) -> None:
        self._receive = receive
        self._sent_left, self._left = sent_limit, limit
        self._sent_limit, self._limit = sent_limit, limit
        self._decoder = decoder
        self._digest = digest
        self._spend = spend
        self._pieces: Iterator[bytes] = iter(())
        self._ended = False

    async def receive(self) -> Message:
        """Return the next part of the body; what is wrong with it is an `HTTPException`."""
        try:
            return await self._next()
        except TensorMapError as error:
            # FastAPI lets this one through where it reads JSON, and `app.problems` unwraps it.
            raise HTTPException(STATUS[type(error)], str(error)) from error

    async def _next(self) -> Message:
        while True:
            for piece in self._pieces:
                if piece:
                    return self._message(piece)
            if self._ended and self._decoder is not None:
                decoder = self._decoder
                self._decoder = None
                decoder.finish()
                return {"type": "http.request", "body": b"", "more_body": False}
            message = await self._receive()
            if message["type"] != "http.request":
                return message
            chunk = message.get("body", b"")
            self._sent_left -= len(chunk)
            if self._sent_left < 0:
                raise BodyTooLarge(
                    f"the body is longer than the {self._sent_limit} bytes that are read"
                )
            self._spend(len(chunk))
            self._digest.add(chunk)
            if not message.get("more_body", False):
                self._ended = True
                self._digest.check()
            if self._decoder is None:
                return message
            self._pieces = self._decoder.feed(chunk)

    def _message(self, piece: bytes) -> Message:
        self._left -= len(piece)
        if self._left < 0:
            raise BodyTooLarge(f"the body unpacks to more than the {self._limit} bytes that may be")
        return {"type": "http.request", "body": piece, "more_body": True}


async def _body(request: Request) -> bytes:
    """Read a body whole."""
    return await request.body()


Body = Annotated[bytes, Depends(_body)]


def media_type(content_type: str | None) -> str:
    """Return a Content-Type without its parameters, lower case, empty if there is none."""
    return (content_type or "").partition(";")[0].strip().lower()


def binary_body(**described: str) -> dict[str, Any]:
    """Return the `openapi_extra` of a route that takes bodies of these media types."""
    return {
        "requestBody": {
            "required": True,
            "content": {
                name: {"schema": {"type": "string", "format": "binary", "description": text}}
                for name, text in described.items()
            },
        }
    }


SCAN_BODY = binary_body(
    **{
        f.media_type: f"A scan as {f.name} ({' '.join(f.suffixes) or 'no suffix'})"
        for f in SCAN_FORMATS
    },
    **{
        "application/octet-stream": "A scan whose first bytes tell its format: "
        + ", ".join(f.name for f in SCAN_FORMATS if f.magics)
    },
)
