"""A service manager gets a message when the service is ready, and none of a blocked loop."""

import asyncio
import os
import socket
import tempfile
import time
from pathlib import Path

import pytest

from app.systemd import notify, supervised


@pytest.fixture
def manager():
    """A socket as systemd makes one, and its environment variables."""
    with (
        tempfile.TemporaryDirectory() as folder,  # a socket's path has at most 108 bytes
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening,
    ):
        address = Path(folder) / "notify"
        listening.bind(str(address))
        listening.setblocking(False)
        yield listening, {"NOTIFY_SOCKET": str(address), "WATCHDOG_USEC": "40000"}


def heard(listening):
    messages = []
    while True:
        try:
            messages.append(listening.recv(100).decode())
        except BlockingIOError:
            return messages


def test_a_manager_hears_of_the_start_of_each_turn_and_of_the_end(manager):
    listening, environment = manager

    async def serve():
        async with supervised(environment):
            messages: list[str] = []
            while len(messages) < 4:
                messages += heard(listening)
                await asyncio.sleep(0.01)
            return messages

    assert asyncio.run(serve())[:4] == ["READY=1", *["WATCHDOG=1"] * 3]
    assert heard(listening)[-1] == "STOPPING=1"


def test_a_blocked_loop_sends_nothing(manager):
    listening, environment = manager

    async def serve():
        async with supervised(environment):
            await asyncio.sleep(0.05)
            heard(listening)
            time.sleep(0.2)  # ten times as long as the manager hears of us
            return heard(listening)

    assert asyncio.run(serve()) == []


@pytest.mark.parametrize(
    "odd",
    [{"WATCHDOG_USEC": "soon"}, {"WATCHDOG_USEC": ""}, {"WATCHDOG_PID": str(os.getpid() + 1)}],
)
def test_where_no_watchdog_is_wanted_of_this_process_none_is_sent(manager, odd):
    listening, environment = manager

    async def serve():
        async with supervised({**environment, **odd}):
            await asyncio.sleep(0.05)

    asyncio.run(serve())
    assert heard(listening) == ["READY=1", "STOPPING=1"]


@pytest.mark.parametrize("address", ["", "relative", "/nobody/listens/here", "@nobody"])
def test_nobody_who_listens_is_no_fault(address):
    notify("READY=1", {"NOTIFY_SOCKET": address})
