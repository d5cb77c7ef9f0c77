"""How many connections a process accepts, and which is closed first."""

import asyncio
import resource
import socket
import sys
from pathlib import Path

import pytest
import uvicorn

from app.http.connections import (
    BoundedConnection,
    BoundedServer,
    ConnectionSlots,
    connection_options,
    within_descriptors,
)
from app.settings import Settings


@pytest.fixture
def descriptors(monkeypatch):
    """Sets the limits of descriptors, soft and hard, of a process that is not this one."""
    limits: list[int] = []
    monkeypatch.setattr(resource, "getrlimit", lambda _which: tuple(limits))
    monkeypatch.setattr(
        resource, "setrlimit", lambda _which, given: limits.__setitem__(0, given[0])
    )

    def chosen(soft, hard):
        limits[:] = [soft, hard]
        return limits

    return chosen


def bounds(**chosen):
    settings = within_descriptors(Settings(**chosen))
    return settings.max_connections, settings.max_streams, settings.max_streams_per_key


@pytest.mark.parametrize(
    ("soft", "hard", "expected"),
    [
        (1024, 524_288, (4096, 2000, 1000)),
        (1024, 1024, (512, 256, 128)),
        (256, 256, (128, 64, 32)),
        (1024, 4096, (3584, 1792, 896)),
    ],
)
def test_connections_are_what_the_raised_descriptors_allow(descriptors, soft, hard, expected):
    limits = descriptors(soft, hard)
    assert bounds() == expected
    assert limits[0] == hard


def test_endless_descriptors_are_no_endless_connections(descriptors):
    descriptors(resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    assert bounds() == (4096, 2000, 1000)
    assert bounds(max_connections=20_000, max_streams=9000)[:2] == (20_000, 9000)


def test_more_connections_than_descriptors_are_lowered_and_reported(descriptors, caplog):
    descriptors(1024, 1024)
    assert bounds(max_connections=5000)[0] == 512
    assert "1024 descriptors allow 512 connections, not 5000" in caplog.text
    assert bounds(max_connections=100, max_streams=10, max_streams_per_key=3) == (100, 10, 3)


def test_descriptors_that_cannot_be_raised_are_taken_as_they_are(descriptors, monkeypatch):
    descriptors(1024, 4096)

    def refuse(*_):
        raise ValueError("not allowed to raise maximum limit")

    monkeypatch.setattr(resource, "setrlimit", refuse)
    assert bounds()[0] == 512


class Idle(BoundedConnection):
    """A connection that only notes that it was closed."""

    def __init__(self, closed, name):
        self.closed, self.name = closed, name

    def close_now(self):
        self.closed.append(self.name)


def test_idle_connections_are_closed_in_order_and_the_log_line_comes_once_in_ten_seconds(caplog):
    now = [0.0]
    closed: list[str] = []
    slots = ConnectionSlots(4, clock=lambda: now[0])
    kept, first, second, busy = (Idle(closed, name) for name in ("kept", "first", "second", "busy"))
    slots.idle(kept, used=True)
    for fresh in (first, busy, second):
        slots.idle(fresh, used=False)
    slots.busy(busy)
    assert slots.has_room(4)
    assert [slots.has_room(5) for _ in range(5)] == [True, True, True, False, False]
    assert closed == ["first", "second", "kept"]
    assert len(caplog.records) == 1
    now[0] = 10.0
    assert not slots.has_room(5)
    assert "2 that waited for their clients were closed for others, 3 were refused" in caplog.text


def test_of_connections_in_use_those_are_closed_whose_clients_have_their_answer_or_do_not_read():
    now = [0.0]
    closed: list[str] = []
    slots = ConnectionSlots(4, clock=lambda: now[0])
    idle, answered, slow, hung = (
        Idle(closed, name) for name in ("idle", "answered", "slow", "hung")
    )
    slots.unread(hung)
    slots.unread(slow)
    slots.answered(answered)
    slots.idle(idle, used=True)
    assert slots.has_room(4)
    assert [slots.has_room(5) for _ in range(3)] == [True, True, False]
    now[0] = 3.0
    slots.read(slow)  # a part of a large answer
    slots.unread(slow)
    now[0] = 6.0
    assert [slots.has_room(5) for _ in range(2)] == [True, False]
    assert closed == ["idle", "answered", "hung"]


@pytest.mark.skipif(not hasattr(socket, "TCP_INFO"), reason="Linux reports a socket's queue")
def test_many_connections_wait_while_a_few_are_accepted_at_a_time(monkeypatch):
    async def started(_server, sockets=None):
        for listening in sockets:
            listening.listen(options["backlog"])  # as asyncio does

    monkeypatch.setattr(uvicorn.Server, "startup", started)
    monkeypatch.setattr("app.http.connections.collect_seldom", lambda: None)
    options = connection_options(Settings())
    longest = int(Path("/proc/sys/net/core/somaxconn").read_text())
    with socket.create_server(("127.0.0.1", 0)) as listening:
        server = BoundedServer(uvicorn.Config("app", log_config=None, backlog=options["backlog"]))
        asyncio.run(server.startup([listening]))
        info = listening.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 32)
    waiting = int.from_bytes(info[28:32], sys.byteorder)  # tcpi_sacked: the queue, of a listener
    assert options["backlog"] <= 64 < min(2048, longest) == waiting


def test_answers_that_would_last_are_ended_before_a_stop_waits_for_the_others(monkeypatch):
    happened = []

    async def stopped(_server, sockets=None):
        happened.append("waits")

    monkeypatch.setattr(uvicorn.Server, "shutdown", stopped)
    server = BoundedServer(uvicorn.Config("app", log_config=None), lambda: happened.append("ends"))
    asyncio.run(server.shutdown())
    assert happened == ["ends", "waits"]


def test_a_request_notices_that_its_client_left_though_another_one_waits_behind_it():
    async def left_after(sent):
        left = asyncio.Event()

        async def app(scope, receive, send):
            assert scope["path"] == "/first"
            await send({"type": "http.response.start", "status": 200, "headers": []})
            while (await receive())["type"] != "http.disconnect":
                pass
            left.set()

        options = connection_options(within_descriptors(Settings()))
        server = BoundedServer(uvicorn.Config(app, log_config=None, lifespan="off", **options))
        with socket.create_server(("127.0.0.1", 0)) as listening:
            serving = asyncio.create_task(server.serve([listening]))
            reader, writer = await asyncio.open_connection(*listening.getsockname())
            writer.write(sent)
            assert await reader.readline() == b"HTTP/1.1 200 OK\r\n"
            writer.close()
            await asyncio.wait_for(left.wait(), 20)
            server.should_exit = True
            await serving

    first, second = (
        b"GET /%b HTTP/1.1\r\nHost: a\r\n\r\n" % path for path in (b"first", b"second")
    )
    asyncio.run(left_after(first))
    asyncio.run(left_after(first + second))


def test_a_client_that_still_reads_its_answer_keeps_its_connection_where_all_are_in_use():
    answer, connections = b"a" * 2**24, 8

    async def app(scope, receive, send):
        head = [(b"content-length", b"%d" % len(answer))]
        await send({"type": "http.response.start", "status": 200, "headers": head})
        await send({"type": "http.response.body", "body": answer})

    async def main():
        options = connection_options(within_descriptors(Settings(max_connections=connections)))
        server = BoundedServer(uvicorn.Config(app, log_config=None, lifespan="off", **options))
        with socket.create_server(("127.0.0.1", 0)) as listening:
            serving = asyncio.create_task(server.serve([listening]))
            opened, heads = [], []
            for _ in range(connections + 1):
                reader, writer = await asyncio.open_connection(*listening.getsockname())
                opened.append((reader, writer))
                writer.write(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n")
                heads.append((await reader.readuntil(b"\r\n\r\n"))[:12])
            assert heads == [b"HTTP/1.1 200"] * connections + [b"HTTP/1.1 503"]
            for reader, _ in opened[:connections]:
                assert await reader.readexactly(len(answer)) == answer
            for _, writer in opened:
                writer.close()
            server.should_exit = True
            await serving

    asyncio.run(main())
