"""Request bodies: which are read at all, and how those that are not JSON are."""

from http import HTTPStatus
from typing import Annotated, Any

from fastapi import Depends, Header, Request
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.errors import BodyTooLarge, UnsupportedBody, problem_response
from storage.formats.registry import SCAN_FORMATS

__all__ = ["SCAN_BODY", "Body", "BodyGuard", "ContentType", "binary_body", "media_type"]

ContentType = Annotated[str | None, Header(include_in_schema=False)]


class BodyGuard:
    """Refuse a body that is compressed, or too long: at once if it says so, else on the way.

    FastAPI's own `max_body_size` answers in plain text; an error of ours is a problem.
    """

    def __init__(self, app: ASGIApp, max_body_bytes: int, max_json_bytes: int) -> None:
        self._app = app
        self._max_body_bytes = max_body_bytes
        self._max_json_bytes = min(max_json_bytes, max_body_bytes)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, its body within the limit."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        encoding = headers.get("content-encoding", "").strip().lower()
        if encoding not in {"", "identity"}:
            refused = UnsupportedBody(f"Content-Encoding is {encoding[:40]!r}, wanted none")
            await problem_response(refused)(scope, receive, send)
            return
        is_json = "json" in headers.get("content-type", "").lower()
        limit = self._max_json_bytes if is_json else self._max_body_bytes
        declared = headers.get("content-length", "")
        if declared.isdecimal() and int(declared) > limit:
            error = BodyTooLarge(f"the body has {declared} bytes, at most {limit} are read")
            await problem_response(error)(scope, receive, send)
            return
        came = 0

        async def limited() -> Message:
            nonlocal came
            message = await receive()
            came += len(message.get("body", b""))
            if came > limit:
                raise HTTPException(
                    HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
                    f"the body is longer than the {limit} bytes that are read",
                )
            return message

        await self._app(scope, limited, send)


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
