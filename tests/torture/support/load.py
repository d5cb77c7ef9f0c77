"""Load on a service: slow uploads, closures that pile up, and a client that measures answers."""

import asyncio
import json
import math
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

_HOST = "127.0.0.1"


@dataclass(frozen=True)
class Request:
    """A request as it goes over the socket.

    Attributes:
        method: Of HTTP.
        path: With its query.
        headers: Besides Host and Content-Length.
        body: Sent whole.
    """

    method: str
    path: str
    headers: Mapping[str, str] = field(default_factory=dict)
    body: bytes = b""

    def head(self, length: int) -> bytes:
        """Return the head of the request, with a body of this length."""
        lines = [
            f"{self.method} {self.path} HTTP/1.1",
            f"Host: {_HOST}",
            f"Content-Length: {length}",
        ]
        lines += [f"{name}: {value}" for name, value in self.headers.items()]
        return "\r\n".join([*lines, "", ""]).encode()


@dataclass
class Answers:
    """What came back, and how long it took.

    Attributes:
        seconds: Of every answer, in their order.
        statuses: How often each status came; 0 is a connection that failed or timed out.
    """

    seconds: list[float] = field(default_factory=list)
    statuses: dict[int, int] = field(default_factory=dict)

    def add(self, status: int, seconds: float) -> None:
        """Note an answer."""
        self.seconds.append(seconds)
        self.statuses[status] = self.statuses.get(status, 0) + 1

    def extend(self, more: "Answers") -> None:
        """Add what came later."""
        self.seconds += more.seconds
        for status, count in more.statuses.items():
            self.statuses[status] = self.statuses.get(status, 0) + count

    def quantile(self, share: float) -> float:
        """Return the seconds within which this share of the answers came."""
        ordered = sorted(self.seconds)
        return ordered[max(0, math.ceil(share * len(ordered)) - 1)]

    def __str__(self) -> str:
        p50, p99, most = map(self.quantile, (0.5, 0.99, 1))
        return f"{self.statuses} p50 {p50:.3f} p99 {p99:.3f} most {most:.3f} s"


class Load:
    """Connections that one key holds open until the block ends.

    Args:
        port: Of the service, on loopback.
    """

    def __init__(self, port: int) -> None:
        self._port = port
        self._tasks: list[asyncio.Task[None]] = []
        self.answers = Answers()

    async def __aenter__(self) -> "Load":
        """Return the load; nothing is open yet."""
        return self

    async def __aexit__(self, *_: object) -> None:
        """Close every connection."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def trickle(self, request: Request, count: int, *, length: int, every_s: float = 1.0) -> None:
        """Keep requests open whose body comes a byte at a time, again when one is answered."""

        async def one() -> None:
            reader, writer = await asyncio.open_connection(_HOST, self._port)
            answer = asyncio.ensure_future(read_answer(reader))
            try:
                writer.write(request.head(length) + request.body)
                began = time.perf_counter()
                while not answer.done():
                    writer.write(b"\0")
                    await asyncio.wait([answer], timeout=every_s)
                self.answers.add((await answer)[0], time.perf_counter() - began)
            finally:
                answer.cancel()
                writer.close()

        self._keep(one, count)

    def repeat(self, request: Request, count: int) -> None:
        """Keep requests open that are sent whole, again when one is answered."""

        async def one() -> None:
            began = time.perf_counter()
            status, _ = await answer_to(self._port, request)
            self.answers.add(status, time.perf_counter() - began)
            if status in {429, 503}:
                await asyncio.sleep(1)

        self._keep(one, count)

    def _keep(self, once: Callable[[], Awaitable[None]], count: int) -> None:
        async def keep() -> None:
            while True:
                try:
                    await once()
                except (OSError, EOFError):
                    self.answers.add(0, 0.0)
                    await asyncio.sleep(0.5)

        self._tasks += [asyncio.create_task(keep()) for _ in range(count)]


async def answer_to(port: int, request: Request) -> tuple[int, bytes]:
    """Send a request on a connection of its own and return its status and body."""
    reader, writer = await asyncio.open_connection(_HOST, port)
    try:
        writer.write(request.head(len(request.body)) + request.body)
        return await read_answer(reader)
    finally:
        writer.close()


async def send_repeatedly(
    port: int, requests: Sequence[Request], *, seconds: float, kept: bool, timeout_s: float = 20.0
) -> Answers:
    """Send one request after another, and return how long each answer took.

    Args:
        port: Of the service.
        requests: Taken in turn.
        seconds: For how long.
        kept: On one connection, else on a new one each.
        timeout_s: What takes longer counts as this long, under status 0.
    """
    answers, number = Answers(), 0
    streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        request, began, status = requests[number % len(requests)], time.perf_counter(), 0
        number += 1
        with suppress(OSError, EOFError, TimeoutError):
            async with asyncio.timeout(timeout_s):
                if streams is None:
                    streams = await asyncio.open_connection(_HOST, port)
                streams[1].write(request.head(len(request.body)) + request.body)
                status, _ = await read_answer(streams[0])
        answers.add(status, time.perf_counter() - began)
        if streams is not None and not (kept and status):
            streams[1].close()
            streams = None
        await asyncio.sleep(0.02)
    if streams is not None:
        streams[1].close()
    return answers


async def read_answer(reader: asyncio.StreamReader) -> tuple[int, bytes]:
    """Return the status and body of an answer that gives its length."""
    head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1")
    first, *lines = head.split("\r\n")
    fields = dict(line.lower().split(": ", 1) for line in lines if ": " in line)
    length = int(fields.get("content-length", "0"))
    return int(first.split()[1]), await reader.readexactly(length)


def as_json(value: object) -> bytes:
    """Return a JSON body."""
    return json.dumps(value).encode()
