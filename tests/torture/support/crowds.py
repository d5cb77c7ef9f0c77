"""Crowds of connections: those that do nothing, and WebSockets by the thousand."""

import asyncio
import base64
import os
from collections import Counter
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, suppress

_HOST = "127.0.0.1"
_AT_ONCE, _STREAMS_AT_ONCE = 50, 20
_PATIENCE_S = 30.0
_PING, _PONG, _PING_BYTES = 0x89, 0x8A, 6  # Uvicorn's has four bytes of content


class Crowd:
    """Connections that are kept open.

    Attributes:
        answers: How often each status came, 0 where none did.
        closed: How many the service closed.
    """

    def __init__(self, port: int) -> None:
        self.answers: Counter[int] = Counter()
        self.closed = 0
        self._port = port
        self._open: set[asyncio.StreamWriter] = set()
        self._tasks: set[asyncio.Task[None]] = set()

    def __len__(self) -> int:
        return len(self._open)

    def __str__(self) -> str:
        answers = f", answered {dict(self.answers)}" if self.answers else ""
        return f"{len(self)} open, {self.closed} closed{answers}"

    async def connect(self, sent: bytes) -> int:
        """Open a connection, send this and keep it open; return the status that came, 0 if none."""
        try:
            async with asyncio.timeout(_PATIENCE_S):
                reader, writer = await asyncio.open_connection(_HOST, self._port)
        except (OSError, TimeoutError):
            self.answers[0] += 1
            return 0
        status = 0
        if sent:
            writer.write(sent)
            with suppress(OSError, TimeoutError, asyncio.IncompleteReadError, ValueError):
                async with asyncio.timeout(_PATIENCE_S):
                    status = int((await reader.readuntil(b"\r\n\r\n")).split()[1])
            self.answers[status] += 1
        self._open.add(writer)
        watching = asyncio.create_task(self._watch(reader, writer))
        self._tasks.add(watching)
        watching.add_done_callback(self._tasks.discard)
        return status

    async def _watch(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while received := await reader.read(2**16):
                if len(received) == _PING_BYTES and received[0] == _PING:
                    writer.write(bytes([_PONG, 0x80 | 4]) + bytes(4) + received[2:])
        self.closed += 1
        self._open.discard(writer)
        writer.close()

    async def close(self) -> None:
        """Close all."""
        for task in tuple(self._tasks):
            task.cancel()
        for writer in tuple(self._open):
            writer.transport.abort()
        self._open.clear()
        await asyncio.sleep(0)


@asynccontextmanager
async def idle_connections(port: int, count: int) -> AsyncIterator[Crowd]:
    """Keep so many connections open that never send a byte; what is closed is opened again."""

    async def keep_up() -> None:
        while True:
            missing = min(count - len(crowd), _AT_ONCE)
            if missing > 0:
                await asyncio.gather(*(crowd.connect(b"") for _ in range(missing)))
            await asyncio.sleep(0.01 if missing > 0 else 0.2)

    async with _crowd(port) as crowd:
        keeping = asyncio.create_task(keep_up())
        try:
            while len(crowd) < count and crowd.answers[0] < count:
                await asyncio.sleep(0.05)
            yield crowd
        finally:
            keeping.cancel()
            with suppress(asyncio.CancelledError):
                await keeping


@asynccontextmanager
async def open_websockets(
    port: int, path: str, headers: Mapping[str, str], count: int
) -> AsyncIterator[Crowd]:
    """Try to open so many WebSockets, and keep open what the service accepts."""
    key = base64.b64encode(os.urandom(16)).decode()
    lines = [
        f"GET {path} HTTP/1.1",
        f"Host: {_HOST}",
        "Connection: Upgrade",
        "Upgrade: websocket",
        "Sec-WebSocket-Version: 13",
        f"Sec-WebSocket-Key: {key}",
        *(f"{name}: {value}" for name, value in headers.items()),
    ]
    upgrade = "\r\n".join([*lines, "", ""]).encode()
    async with _crowd(port) as crowd:
        left = count

        async def opener() -> None:
            nonlocal left
            while left > 0:
                left -= 1
                await crowd.connect(upgrade)

        await asyncio.gather(*(opener() for _ in range(_STREAMS_AT_ONCE)))
        yield crowd


@asynccontextmanager
async def _crowd(port: int) -> AsyncIterator[Crowd]:
    async with AsyncExitStack() as stack:
        crowd = Crowd(port)
        stack.push_async_callback(crowd.close)
        yield crowd
