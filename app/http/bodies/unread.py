"""Unread bodies: closes the connection of a request that was answered without reading them."""

import asyncio
import time
from collections.abc import Callable

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

ANSWERED = "tensormap.answered"
"""The extension of a server that counts connections: `call` is called when an answer is sent, and
only its client's body still comes. Where connections are short, such a one is closed."""

_DRAINED_BYTES = 256 * 2**20
_DRAINED_S = 30.0
_IDLE_S = 2.0


class UnreadBody:
    """Closes the connection of an answer that was sent before its request's body was read.

    The answer is sent at once. A client that sends first and reads later would lose it if the
    connection were closed at once too, so the rest of the body is read and dropped for a while.
    The connection may be closed for another one meanwhile (`app.http.connection_slots`).
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        headers = Headers(scope=scope) if scope["type"] == "http" else None
        if headers is None or not _has_body(headers):
            await self._app(scope, receive, send)
            return
        answered = scope.get("extensions", {}).get(ANSWERED, {}).get("call", lambda: None)
        exchange = _Exchange(receive, send, answered, waits="expect" in headers)
        await self._app(scope, exchange.receive, exchange.send)


class _Exchange:
    """A request with a body, and its answer.

    Args:
        receive: Receives the body.
        send: Sends the answer.
        answered: Called when the answer is sent, and the body still comes.
        waits: The client sends its body only after `100 Continue`.
    """

    def __init__(
        self, receive: Receive, send: Send, answered: Callable[[], None], *, waits: bool
    ) -> None:
        self._receive, self._send, self._answered = receive, send, answered
        self._sends = not waits
        self._ended = False
        self._closes = False

    async def receive(self) -> Message:
        self._sends = True
        message = await self._receive()
        if message["type"] != "http.request" or not message.get("more_body", False):
            self._ended = True
        return message

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start" and not self._ended:
            self._closes = True
            MutableHeaders(scope=message)["Connection"] = "close"
        last = message["type"] == "http.response.body" and not message.get("more_body", False)
        if not (last and self._closes and self._sends and not self._ended):
            await self._send(message)
            return
        await self._send({**message, "more_body": True})
        self._answered()
        await self._drain()
        await self._send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _drain(self) -> None:
        left, end_s = _DRAINED_BYTES, time.monotonic() + _DRAINED_S
        while not self._ended and left > 0 and (wait_s := end_s - time.monotonic()) > 0:
            try:
                async with asyncio.timeout(min(_IDLE_S, wait_s)):
                    message = await self.receive()
            except TimeoutError:
                return
            left -= len(message.get("body", b""))


def _has_body(headers: Headers) -> bool:
    return "transfer-encoding" in headers or headers.get("content-length", "0").strip("0") != ""
