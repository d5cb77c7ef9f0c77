"""Connections whose answers end in time, however slowly their parts arrive.

The HTTP library limits each read by itself: a server, or a proxy, that sends a line of its answer's
head now and then would hold a vehicle for as long as it likes.
"""

import ssl
import time
from typing import Any

import httpx2


class AsyncTimedStream:
    """A connection's stream: what arrives after a request has a time in total.

    It has the methods of the HTTP library's streams.
    """

    def __init__(self, stream: Any) -> None:  # noqa: ANN401 - of the HTTP library, which exports none
        self._stream = stream
        self._is_answering = False
        self._end_s: float | None = None

    def limit(self, within_s: float | None) -> None:
        """Limit the time of all reads from now to the next request; `None` for each by itself."""
        self._end_s = None if within_s is None else time.monotonic() + within_s

    async def write(self, buffer: bytes, timeout: float | None = None) -> None:
        """Send a part of a request."""
        self._is_answering = False
        await self._stream.write(buffer, timeout)

    async def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        """Return what has arrived.

        Raises:
            ReadTimeout: If the time is over.
        """
        if not self._is_answering:
            self._is_answering = True
            self.limit(timeout)
        if self._end_s is not None:
            left_s = self._end_s - time.monotonic()
            if left_s <= 0.0:
                raise httpx2.ReadTimeout("its answer took too long")
            timeout = left_s if timeout is None else min(timeout, left_s)
        received: bytes = await self._stream.read(max_bytes, timeout)
        return received

    async def aclose(self) -> None:
        """Close it."""
        await self._stream.aclose()

    async def start_tls(self, *args: Any, **options: Any) -> "AsyncTimedStream":  # noqa: ANN401
        """Return the same with TLS."""
        return AsyncTimedStream(await self._stream.start_tls(*args, **options))

    def get_extra_info(self, info: str) -> Any:  # noqa: ANN401 - as the HTTP library has it
        """Return what is known of the connection."""
        return self._stream.get_extra_info(info)


class AsyncTimedBackend:
    """Opens such streams, as a network backend of the HTTP library."""

    def __init__(self, backend: Any) -> None:  # noqa: ANN401 - of the HTTP library, which exports none
        self._backend = backend

    async def connect_tcp(self, *args: Any, **options: Any) -> AsyncTimedStream:  # noqa: ANN401
        """Open a connection."""
        return AsyncTimedStream(await self._backend.connect_tcp(*args, **options))

    async def sleep(self, seconds: float) -> None:
        """Wait."""
        await self._backend.sleep(seconds)


def timed_connections(tls: ssl.SSLContext, proxy: str | None) -> httpx2.AsyncHTTPTransport:
    """Return the HTTP library's connections, with these streams.

    Args:
        tls: How to check certificates.
        proxy: The proxy's URL, if there is one.

    Raises:
        ImportError: If the proxy needs a package.
        ValueError: If there is no such kind of proxy.
        InvalidURL: If its URL is none.
    """
    connections = httpx2.AsyncHTTPTransport(verify=tls, proxy=proxy, trust_env=False)
    # The library has network backends, and no argument to pass one on. If a later version has other
    # names, each read has the timeout by itself, as without this.
    pool = getattr(connections, "_pool", None)
    backend = getattr(pool, "_network_backend", None)
    if pool is not None and backend is not None:
        pool._network_backend = AsyncTimedBackend(backend)
    return connections


def limit_body(answer: httpx2.Response, within_s: float | None) -> None:
    """Limit the time of an answer's body, whose head has arrived; `None` for each part by itself.

    What no network sent, as in tests, is not limited.
    """
    stream = answer.extensions.get("network_stream")
    if isinstance(stream, AsyncTimedStream):
        stream.limit(within_s)
