"""How many connections a process accepts, and how it starts and stops."""

import asyncio
import resource
import socket
import sys
from pathlib import Path

import pytest
import uvicorn

from app.http.server import BoundedServer, connection_options, within_descriptors
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


@pytest.mark.skipif(not hasattr(socket, "TCP_INFO"), reason="Linux reports a socket's queue")
def test_many_connections_wait_while_a_few_are_accepted_at_a_time(monkeypatch):
    async def started(_server, sockets=None):
        for listening in sockets:
            listening.listen(options["backlog"])  # as asyncio does

    monkeypatch.setattr(uvicorn.Server, "startup", started)
    monkeypatch.setattr("app.http.server.collect_seldom", lambda: None)
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
