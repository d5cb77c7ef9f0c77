"""Load on a service over plain sockets, and the CPU time of the process that bears it.

The client does as little as possible, so that on the other core it is faster than the service.
"""

import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_START_S = 60.0


class NotAnswered(Exception):
    """A request that a benchmark times was answered with no success, or not at all."""


class Connection:
    """One kept connection; each request is answered before the next is sent."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=60)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def ask(self, request: bytes) -> bytes:
        """Return the body of the answer.

        Raises:
            NotAnswered: If it is no success, so that its time is of no request.
        """
        self._socket.sendall(request)
        received = b""
        while b"\r\n\r\n" not in received:
            received += self._more()
        head, _, body = received.partition(b"\r\n\r\n")
        fields = head.lower().split(b"\r\n")
        length = next((int(f[15:]) for f in fields if f.startswith(b"content-length:")), 0)
        while len(body) < length:
            body += self._more()
        if head[9:10] != b"2":
            raise NotAnswered(f"{request[:80]!r} was answered with {head[:40]!r} {body[:300]!r}")
        return body

    def _more(self) -> bytes:
        received = self._socket.recv(2**18)
        if not received:
            raise NotAnswered("the service closed a connection")
        return received

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


def request(
    method: str, path: str, body: bytes = b"", headers: Mapping[str, str] | None = None
) -> bytes:
    """Return a request as it is sent."""
    fields = {"Host": "127.0.0.1", "Content-Length": str(len(body)), **(headers or {})}
    head = "".join(f"{name}: {value}\r\n" for name, value in fields.items())
    return f"{method} {path} HTTP/1.1\r\n{head}\r\n".encode() + body


def once(port: int, asked: bytes) -> bytes:
    """Return the answer to one request on a connection of its own."""
    connection = Connection(port)
    answer = connection.ask(asked)
    connection.close()
    return answer


def cpu_s(pid: int) -> float:
    """Return the CPU seconds of a process and of its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S


def rss_mb(pid: int) -> float:
    """Return the resident memory of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def cpu_ms_each(pid: int, port: int, requests: Sequence[bytes], count: int) -> float:
    """Return the CPU milliseconds of a process for each of `count` requests on one connection."""
    connection = Connection(port)
    for number in range(max(20, count // 10)):  # caches are filled
        connection.ask(requests[number % len(requests)])
    begun = cpu_s(pid)
    for number in range(count):
        connection.ask(requests[number % len(requests)])
    spent = cpu_s(pid) - begun
    connection.close()
    return 1e3 * spent / count


def wall_ms(port: int, requests: Sequence[bytes]) -> list[float]:
    """Return how long the answer to each request took, one after another."""
    connection, times = Connection(port), []
    for one in requests:
        begun = time.perf_counter()
        connection.ask(one)
        times.append(1e3 * (time.perf_counter() - begun))
    connection.close()
    return times


def most_per_s(port: int, requests: Sequence[bytes], clients: int, seconds: float) -> float:
    """Return how many requests a second are answered to several clients at once.

    Raises:
        NotAnswered: If one is answered with no success.
    """
    ends = time.perf_counter() + seconds
    answered = [0] * clients

    def keep_asking(client: int) -> None:
        with closing(Connection(port)) as connection:
            while time.perf_counter() < ends:
                connection.ask(requests[(client + answered[client]) % len(requests)])
                answered[client] += 1

    in_threads([partial(keep_asking, client) for client in range(clients)])
    return sum(answered) / seconds


def in_threads(tasks: Sequence[Callable[[], None]]) -> None:
    """Run each in a thread of its own, and raise what one of them raised."""
    with ThreadPoolExecutor(len(tasks)) as pool:
        for running in [pool.submit(task) for task in tasks]:
            running.result()


@contextmanager
def server(arguments: Sequence[str], **environment: str) -> Iterator[tuple[int, int]]:
    """Run a server in a process of its own; yield its process id and its port.

    Args:
        arguments: Python's arguments; the server prints its URL.
        environment: Variables besides those of this process.
    """
    with subprocess.Popen(
        [sys.executable, *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env={**_as_installed(), **environment},
    ) as process:
        try:
            yield process.pid, _port(process)
        finally:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(20)
            process.kill()


def _as_installed() -> dict[str, str]:
    """Return the environment in which modules are compiled once, as those of a wheel."""
    return {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


def _port(process: subprocess.Popen[bytes]) -> int:
    assert process.stderr is not None  # noqa: S101 - it was requested
    for line in process.stderr:
        if b"http://127.0.0.1:" in line:
            # What it logs later must not fill the pipe.
            threading.Thread(target=process.stderr.read, daemon=True).start()
            port = int(line.split(b"http://127.0.0.1:")[1].split()[0].rstrip(b"/"))
            _await_ready(port)
            return port
    raise SystemExit("the server did not start")


def _await_ready(port: int) -> None:
    ends = time.perf_counter() + _START_S
    while time.perf_counter() < ends:
        with suppress(OSError):
            connection = Connection(port)
            connection.ask(request("GET", "/readyz"))
            connection.close()
            return
        time.sleep(0.02)
    raise SystemExit("the server was not ready in time")
