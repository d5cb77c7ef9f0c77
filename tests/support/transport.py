"""The way from a client to an application in this process.

Starlette's test client hands every message of a request over between two threads by itself, ten
times in all, which takes far longer than most answers do.
"""

from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import unquote

import anyio
import httpx2
from anyio.from_thread import BlockingPortal
from starlette.types import ASGIApp, Message, Scope

__all__ = ["IN_PARTS", "AtOnce"]

IN_PARTS = "in_parts"
"""The extension of a request whose answer is read while it is sent."""


class AtOnce(httpx2.BaseTransport):
    """Hands a request over whole, and the answer once it has ended.

    Args:
        app: The application.
        in_parts: The transport of WebSockets and of answers that are read while they are sent.
        portal: Gives the way into the application's event loop.
        state: What the application's lifespan keeps for its requests.
        client: The address that requests come from.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        in_parts: httpx2.BaseTransport,
        portal: Callable[[], BlockingPortal],
        state: Mapping[str, Any],
        client: tuple[str, int],
    ) -> None:
        self._app = app
        self._in_parts = in_parts
        self._portal = portal
        self._state = state
        self._client = client

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        if request.url.scheme != "http" or request.extensions.get(IN_PARTS):
            return self._in_parts.handle_request(request)
        exchange = _Exchange(request.read())
        self._portal().call(exchange.run, self._app, self._scope(request))
        return httpx2.Response(
            exchange.status,
            headers=exchange.headers,
            content=b"" if request.method == "HEAD" else exchange.content,
            request=request,
        )

    def close(self) -> None:
        self._in_parts.close()

    def _scope(self, request: httpx2.Request) -> Scope:
        path, _, query = request.url.raw_path.partition(b"?")
        return {
            "type": "http",
            "asgi": {"version": "3.0", "spec_version": "2.3"},  # Uvicorn's
            "http_version": "1.1",
            "method": request.method,
            "path": unquote(path.decode()),
            "raw_path": path,
            "root_path": "",
            "scheme": request.url.scheme,
            "query_string": query,
            "headers": [(name.lower(), value) for name, value in request.headers.raw],
            "client": self._client,
            "server": (request.url.host, request.url.port or 80),
            "state": dict(self._state),
        }


class _Exchange:
    """A request's body and its answer, a 500 if there is none."""

    def __init__(self, body: bytes) -> None:
        self.status = 500
        self.headers: list[tuple[bytes, bytes]] = []
        self.content = b""
        self._body: bytes | None = body
        self._answered: anyio.Event

    async def run(self, app: ASGIApp, scope: Scope) -> None:
        self._answered = anyio.Event()
        try:
            await app(scope, self._receive, self._send)
        except Exception:
            if self.status < 500:  # else it was told, and is raised again for the server's log
                raise

    async def _receive(self) -> Message:
        if self._body is None:
            await self._answered.wait()
            return {"type": "http.disconnect"}
        body, self._body = self._body, None
        return {"type": "http.request", "body": body, "more_body": False}

    async def _send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]
            self.headers = list(message["headers"])
            return
        self.content += message.get("body", b"")
        if not message.get("more_body", False):
            self._answered.set()
