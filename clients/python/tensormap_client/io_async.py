"""The asynchronous one of what is written twice: waiting, workers, streams; see `io_sync`."""

import asyncio
import os
import ssl
from collections.abc import Callable, Coroutine, Mapping
from types import TracebackType
from typing import Any, Generic, ParamSpec, Self, TypeVar

import httpx2
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus, WebSocketException

from tensormap_client.causes import why
from tensormap_client.errors import Unreachable
from tensormap_client.rejections import redirection, rejection
from tensormap_client.urls import shown

T = TypeVar("T")
P = ParamSpec("P")


async def sleep(seconds: float) -> None:
    """Wait."""
    await asyncio.sleep(seconds)


async def read(answer: httpx2.Response, within_s: float | None) -> None:
    """Read an answer to its end.

    Raises:
        ReadTimeout: If it takes longer, though each part may arrive in time.
    """
    try:
        async with asyncio.timeout(within_s):
            await answer.aread()
    except TimeoutError as error:
        raise httpx2.ReadTimeout(f"its answer took more than {within_s:g} s") from error


async def computed(function: Callable[[], T]) -> T:
    """Return what a function computes, in a thread of its own."""
    return await asyncio.to_thread(function)


class AsyncWork(Generic[T]):
    """Work that was started."""

    def __init__(self, task: asyncio.Task[T], failures: list[BaseException]) -> None:
        self._task, self._failures = task, failures

    async def result(self) -> T:
        """Wait for its end and return what it returned, or raise what it raised.

        Raises:
            BaseException: What other work raised that ended this one.
        """
        try:
            return await self._task
        except asyncio.CancelledError:
            waiting = asyncio.current_task()
            if self._failures and not (waiting is not None and waiting.cancelling()):
                raise self._failures[0] from None
            raise


class AsyncWorkers:
    """Runs several coroutines at a time; the end of its block waits for those that still run.

    After a failure, or if the block is left by an error, those that still run are cancelled.

    Args:
        most: How many may run at the same time.
    """

    def __init__(self, most: int) -> None:
        self._most = asyncio.Semaphore(most)
        self._tasks: set[asyncio.Task[Any]] = set()
        self._failures: list[BaseException] = []

    def _note(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        failure = None if task.cancelled() else task.exception()
        if failure is not None:
            self._failures.append(failure)
            self._cancel()

    def _cancel(self) -> None:
        for task in self._tasks:
            task.cancel()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is not None:
            self._cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def start(
        self, function: Callable[P, Coroutine[Any, Any, T]], *args: P.args, **options: P.kwargs
    ) -> AsyncWork[T]:
        """Start a coroutine."""

        async def limited() -> T:
            async with self._most:
                return await function(*args, **options)

        task = asyncio.create_task(limited())
        self._tasks.add(task)
        task.add_done_callback(self._note)
        return AsyncWork(task, self._failures)


class AsyncKept(Generic[T]):
    """A call that goes on when its caller stops waiting; the next caller has its result.

    Args:
        function: What is called.
    """

    def __init__(self, function: Callable[[], Coroutine[Any, Any, T]]) -> None:
        self._function = function
        self._task: asyncio.Task[T] | None = None

    @property
    def is_begun(self) -> bool:
        """Whether there is a call whose result nobody has yet; one of an ended loop is none."""
        task = self._task
        return task is not None and not task.cancelled() and not task.get_loop().is_closed()

    async def result(self) -> T:
        """Return the result of the call that was begun, or else of a new one."""
        if self._task is None or not self.is_begun:
            self._task = asyncio.create_task(self._function())
            self._task.add_done_callback(_note_failure)
        task = self._task
        # It goes on if the caller is cancelled, which keeps it. So it would in `asyncio.shield`,
        # which since Python 3.14 logs what fails when nobody waits any more.
        await asyncio.wait([task])
        if self._task is task and not task.cancelled():
            self._task = None  # another one who waited may have begun the next call
        return task.result()


def _note_failure(task: asyncio.Task[Any]) -> None:
    """Take note of a failure, which asyncio would log if nobody asked for the result again."""
    if not task.cancelled():
        task.exception()


class _Connect(connect):
    """Follows no redirect, as HTTP requests: before websockets 16.1 it would send the key along."""

    def process_redirect(self, exc: Exception) -> Exception:
        return exc


class AsyncStream:
    """A WebSocket on which each message is answered by one."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection, self._process = connection, os.getpid()

    @classmethod
    async def open(
        cls,
        url: str,
        headers: dict[str, str],
        tls: ssl.SSLContext | None,
        timeout_s: float,
        *,
        proxy: str | None,
    ) -> "AsyncStream":
        """Open a WebSocket, through a proxy if one is given.

        Raises:
            Unreachable: If the service does not answer in time, or another host redirects.
            Rejected: If it rejects the stream.
        """
        try:
            connection = await _Connect(
                url,
                additional_headers=headers,
                ssl=tls,
                open_timeout=timeout_s,
                close_timeout=timeout_s,
                compression=None,
                proxy=proxy,
            )
        except InvalidStatus as error:
            answer = error.response
            if "Location" in answer.headers:
                raise redirection("opening a stream", answer.headers) from error
            body = bytes(answer.body or b"")
            raise rejection(shown(url), answer.status_code, body, answer.headers) from error
        except (OSError, TimeoutError, WebSocketException, ImportError) as error:
            # SOCKS needs a package.
            raise Unreachable(f"{shown(url)} cannot be opened: {why(error)}") from error
        return cls(connection)

    @property
    def headers(self) -> Mapping[str, str]:
        """The headers of the answer that opened it."""
        answer = self._connection.response
        return {} if answer is None else answer.headers

    async def exchange(self, message: bytes, timeout_s: float) -> str | bytes:
        """Send a message and return its answer.

        Raises:
            Unreachable: If no answer arrives in time; the stream is then unusable.
        """
        try:
            async with asyncio.timeout(timeout_s):
                await self._connection.send(message)
                return await self._connection.recv()
        except (OSError, TimeoutError, WebSocketException) as error:
            raise Unreachable(f"the stream broke off: {str(error) or repr(error)}") from error

    async def close(self) -> None:
        """Close the stream without waiting for the other side; a forked process leaves it open."""
        if os.getpid() != self._process:
            return
        self._connection.transport.abort()
