"""An answer ends in time, however slowly its parts arrive."""

import asyncio
from collections.abc import Callable
from typing import Any

import httpx2
import pytest
from tensormap_client import Unreachable
from tensormap_client._async import connections as asynchronous
from tensormap_client._async.transport import AsyncTransport
from tensormap_client._sync import connections as synchronous
from tensormap_client._sync.transport import Transport

from tests.support.process import NO_TLS

HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 52\r\n"
WHOLE = [HEAD + b"\r\n" + b"{}".rjust(52)]
DRIPPING_HEAD = [HEAD, *[b"X-Line: 1\r\n"] * 50, b"\r\n" + b"{}".rjust(52)]
DRIPPING_BODY = [HEAD + b"\r\n", *[b" "] * 50, b"{}"]


class Server:
    """A server of which a part of an answer arrives every 0.4 s, by a clock of its own."""

    def __init__(self, *answers: list[bytes]) -> None:
        self.answers, self.parts = list(answers), list[bytes]()
        self.now_s, self.timeouts_s = 0.0, list[float | None]()

    def monotonic(self) -> float:
        return self.now_s

    def connect_tcp(self, *_: object, **__: object) -> "Server":
        return self

    def start_tls(self, **_: object) -> "Server":
        return self

    def get_extra_info(self, _: str) -> None:
        return None

    def write(self, _: bytes, __: float | None) -> None:
        if not self.parts:
            self.parts = list(self.answers.pop(0))

    def read(self, _: int, timeout_s: float | None) -> bytes:
        self.timeouts_s.append(timeout_s)
        self.now_s += 0.4
        return self.parts.pop(0)

    def close(self) -> None:
        """Nothing is open."""


class AsyncServer:
    """The same, to await."""

    def __init__(self, server: Server) -> None:
        self.server = server

    def get_extra_info(self, _: str) -> None:
        return None

    async def connect_tcp(self, *_: object, **__: object) -> "AsyncServer":
        return self

    async def start_tls(self, **_: object) -> "AsyncServer":
        return self

    async def write(self, body: bytes, timeout_s: float | None) -> None:
        self.server.write(body, timeout_s)

    async def read(self, most: int, timeout_s: float | None) -> bytes:
        return self.server.read(most, timeout_s)

    async def aclose(self) -> None:
        """Nothing is open."""


@pytest.fixture(params=["synchronous", "asynchronous"])
def ask(request, monkeypatch) -> Callable[..., list[Any]]:
    """Asks a server as often as it has answers, with a timeout of one second."""
    is_async = request.param == "asynchronous"
    module: Any = asynchronous if is_async else synchronous

    def asked(server: Server, url: str = "http://maps.example", **options: Any) -> list[Any]:
        monkeypatch.setattr(module, "time", server)
        kind: Any = AsyncTransport if is_async else Transport
        transport = kind(url, timeout_s=1.0, patience_s=0.0)
        backend = transport._client._transport._pool._network_backend
        backend._backend = AsyncServer(server) if is_async else server

        times = range(len(server.answers))

        async def all_answers() -> list[Any]:
            return [await transport.request("GET", "/v1/maps", **options) for _ in times]

        if is_async:
            return asyncio.run(all_answers())
        return [transport.request("GET", "/v1/maps", **options) for _ in times]

    return asked


@pytest.mark.parametrize("url", ["http://maps.example", "https://maps.example"])
def test_a_head_that_drips_for_longer_than_the_timeout_is_none(ask, url) -> None:
    server = Server(DRIPPING_HEAD)
    with pytest.raises(Unreachable, match=r"cannot be reached: its answer took too long$"):
        ask(server, url)
    assert server.timeouts_s == pytest.approx([1.0, 0.6, 0.2])


def test_a_head_that_drips_through_a_proxy_is_none_either(ask, monkeypatch) -> None:
    monkeypatch.setenv("http_proxy", "http://proxy.example:3128")
    server = Server(DRIPPING_HEAD)
    with pytest.raises(Unreachable, match="took too long"):
        ask(server)
    assert server.timeouts_s == pytest.approx([1.0, 0.6, 0.2])


def test_a_body_has_the_timeout_once_more(ask) -> None:
    server = Server(DRIPPING_BODY)
    with pytest.raises(Unreachable, match="took too long"):
        ask(server)
    assert server.timeouts_s == pytest.approx([1.0, 1.0, 0.6, 0.2])


def test_each_part_of_a_download_has_the_timeout(ask) -> None:
    server = Server(DRIPPING_BODY)
    [answer] = ask(server, is_download=True)
    assert len(answer.content) == 52
    assert server.timeouts_s == [1.0] * len(DRIPPING_BODY)


def test_each_answer_of_a_connection_has_the_timeout(ask) -> None:
    server = Server(*[WHOLE] * 5)
    assert len(ask(server)) == 5
    assert server.timeouts_s == pytest.approx([1.0] * 5)


def test_a_library_with_other_names_is_used_as_it_is(monkeypatch) -> None:
    monkeypatch.setattr(httpx2, "HTTPTransport", lambda **_: object())
    assert type(synchronous.timed_connections(NO_TLS, None)) is object
