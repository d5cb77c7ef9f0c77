"""The synchronous one of what is written twice: waiting, workers, streams; see `io_async`."""

import contextlib
import os
import ssl
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any, Generic, ParamSpec, Self, TypeVar

import httpx2
from websockets.exceptions import InvalidStatus, WebSocketException
from websockets.sync.client import ClientConnection, connect

from tensormap_client.causes import why
from tensormap_client.errors import Unreachable
from tensormap_client.rejections import redirection, rejection
from tensormap_client.urls import shown

T = TypeVar("T")
P = ParamSpec("P")

_worker = threading.local()


def sleep(seconds: float) -> None:
    """Wait.

    Raises:
        CancelledError: In a worker, as soon as its block is left by an error, or other work fails.
    """
    ending: threading.Event | None = getattr(_worker, "ending", None)
    if ending is None:
        time.sleep(seconds)
    elif ending.wait(seconds):
        raise CancelledError


def read(answer: httpx2.Response, within_s: float | None) -> None:
    """Read an answer to its end.

    Raises:
        ReadTimeout: If it takes longer, though each part may arrive in time.
    """
    if within_s is not None and isinstance(answer.stream, httpx2.SyncByteStream):
        answer.stream = _Limited(answer.stream, within_s)
    answer.read()


class _Limited(httpx2.SyncByteStream):
    """The body of an answer, as long as its parts arrive within a time in total."""

    def __init__(self, stream: httpx2.SyncByteStream, within_s: float) -> None:
        self._stream, self._within_s = stream, within_s
        self._end_s = time.monotonic() + within_s

    def __iter__(self) -> Iterator[bytes]:
        for part in self._stream:
            if time.monotonic() > self._end_s:
                raise httpx2.ReadTimeout(f"its answer took more than {self._within_s:g} s")
            yield part

    def close(self) -> None:
        self._stream.close()


def computed(function: Callable[[], T]) -> T:
    """Return what a function computes."""
    return function()


class Work(Generic[T]):
    """Work that was started."""

    def __init__(self, future: Future[T], failures: list[BaseException]) -> None:
        self._future, self._failures = future, failures

    def result(self) -> T:
        """Wait for its end and return what it returned, or raise what it raised.

        Raises:
            BaseException: What other work raised that ended this one.
        """
        try:
            return self._future.result()
        except CancelledError:
            if self._failures:
                raise self._failures[0] from None
            raise


class Workers:
    """Runs several functions at a time; the end of its block waits for those that still run.

    After a failure, or if the block is left by an error, none waits for another attempt, and what
    has not begun never does. Only what ends the program is raised at once, `KeyboardInterrupt` and
    `SystemExit`: requests that are on their way then may still arrive.

    Args:
        most: How many may run at the same time.
    """

    def __init__(self, most: int) -> None:
        self._ending = threading.Event()
        self._failures: list[BaseException] = []
        self._pool = ThreadPoolExecutor(most, initializer=self._begin)

    def _begin(self) -> None:
        _worker.ending = self._ending

    def _note(self, future: Future[Any]) -> None:
        if future.cancelled():
            return
        failure = future.exception()
        if failure is not None and not isinstance(failure, CancelledError):
            self._failures.append(failure)
            self._ending.set()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is not None:
            self._ending.set()
        is_end = isinstance(error, KeyboardInterrupt | SystemExit)
        self._pool.shutdown(wait=not is_end, cancel_futures=error is not None)

    def start(self, function: Callable[P, T], *args: P.args, **options: P.kwargs) -> Work[T]:
        """Start a function."""
        future = self._pool.submit(function, *args, **options)
        future.add_done_callback(self._note)
        return Work(future, self._failures)


class Kept(Generic[T]):
    """A call; its caller waits for it to the end.

    Args:
        function: What is called.
    """

    is_begun = False

    def __init__(self, function: Callable[[], T]) -> None:
        self._function = function

    def result(self) -> T:
        """Return the result of a new call."""
        return self._function()


class _Connection(ClientConnection):
    """Follows no redirect, as HTTP requests: websockets 17 would send the scans to another host."""

    def handshake(self, *args: Any, **options: Any) -> None:  # noqa: ANN401 - those of websockets
        try:
            super().handshake(*args, **options)
        except InvalidStatus as error:
            headers = error.response.headers
            if "Location" in headers:
                raise redirection("opening a stream", headers) from error
            raise


class Stream:
    """A WebSocket on which each message is answered by one."""

    def __init__(self, connection: ClientConnection, opened: contextlib.ExitStack) -> None:
        self._connection, self._opened = connection, opened
        self._process = os.getpid()

    @classmethod
    def open(
        cls,
        url: str,
        headers: dict[str, str],
        tls: ssl.SSLContext | None,
        timeout_s: float,
        *,
        proxy: str | None,
    ) -> "Stream":
        """Open a WebSocket, through a proxy if one is given.

        Raises:
            Unreachable: If the service does not answer in time, or another host redirects.
            Rejected: If it rejects the stream.
        """
        opened = contextlib.ExitStack()
        try:
            connection = opened.enter_context(
                connect(
                    url,
                    additional_headers=headers,
                    ssl=tls,
                    open_timeout=timeout_s,
                    close_timeout=timeout_s,
                    compression=None,
                    proxy=proxy,
                    create_connection=_Connection,
                )
            )
        except InvalidStatus as error:
            answer = error.response
            body = bytes(answer.body or b"")
            raise rejection(shown(url), answer.status_code, body, answer.headers) from error
        except (OSError, TimeoutError, WebSocketException, ImportError) as error:
            # SOCKS needs a package.
            raise Unreachable(f"{shown(url)} cannot be opened: {why(error)}") from error
        return cls(connection, opened)

    @property
    def headers(self) -> Mapping[str, str]:
        """The headers of the answer that opened it."""
        answer = self._connection.response
        return {} if answer is None else answer.headers

    def exchange(self, message: bytes, timeout_s: float) -> str | bytes:
        """Send a message and return its answer.

        Raises:
            Unreachable: If no answer arrives in time; the stream is then unusable.
        """
        try:
            self._connection.send(message)
            return self._connection.recv(timeout=timeout_s)
        except (OSError, TimeoutError, WebSocketException) as error:
            raise Unreachable(f"the stream broke off: {str(error) or repr(error)}") from error

    def close(self) -> None:
        """Close the stream without waiting for the other side; a forked process leaves it open."""
        if os.getpid() != self._process:
            return
        self._connection.close_socket()
        self._opened.close()
