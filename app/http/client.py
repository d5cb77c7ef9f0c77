"""The client of a request: whether it still waits for the answer."""

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from starlette.requests import ClientDisconnect
from starlette.types import Receive

LEFT = 499
"""Status of a request whose client left before its answer, as proxies log it; none receives it."""


class Client:
    """The client of one request; threads that work for it call `require_client` regularly.

    Attributes:
        left: Set when the connection was closed.
    """

    def __init__(self) -> None:
        self.left = asyncio.Event()

    async def watch(self, receive: Receive) -> None:
        """Wait for the end of the connection, without reading a body."""
        while (message := await receive())["type"] != "http.disconnect":
            if message.get("more_body", False):
                return
        self.left.set()

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """Make `require_client` check this client within the block."""
        token = _client.set(self)
        try:
            yield
        finally:
            _client.reset(token)


_client: ContextVar[Client | None] = ContextVar("tensormap_client", default=None)


def require_client() -> None:
    """Stop long work if its client has left; called between its units, from any thread.

    Raises:
        ClientDisconnect: If the client of the present request has left.
    """
    client = _client.get()
    if client is not None and client.left.is_set():
        raise ClientDisconnect
