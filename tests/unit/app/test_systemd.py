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
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver,
    ):
        address = Path(folder) / "notify"
        receiver.bind(str(address))
        receiver.setblocking(False)
        yield receiver, {"NOTIFY_SOCKET": str(address), "WATCHDOG_USEC": "40000"}


def received(receiver):
    messages = []
    while True:
        try:
            messages.append(receiver.recv(100).decode())
        except BlockingIOError:
            return messages


def test_a_manager_is_notified_of_the_start_of_each_interval_and_of_the_end(manager):
    receiver, environment = manager

    async def serve():
        async with supervised(environment):
            messages: list[str] = []
            while len(messages) < 4:
                messages += received(receiver)
                await asyncio.sleep(0.01)
            return messages

    assert asyncio.run(serve())[:4] == ["READY=1", *["WATCHDOG=1"] * 3]
    assert received(receiver)[-1] == "STOPPING=1"


def test_a_blocked_loop_sends_nothing(manager):
    receiver, environment = manager

    async def serve():
        async with supervised(environment):
            await asyncio.sleep(0.05)
            received(receiver)
            time.sleep(0.2)  # ten times the interval between notifications
            return received(receiver)

    assert asyncio.run(serve()) == []


@pytest.mark.parametrize(
    "odd",
    [{"WATCHDOG_USEC": "soon"}, {"WATCHDOG_USEC": ""}, {"WATCHDOG_PID": str(os.getpid() + 1)}],
)
def test_without_a_valid_watchdog_of_this_process_no_watchdog_message_is_sent(manager, odd):
    receiver, environment = manager

    async def serve():
        async with supervised({**environment, **odd}):
            await asyncio.sleep(0.05)

    asyncio.run(serve())
    assert received(receiver) == ["READY=1", "STOPPING=1"]


@pytest.mark.parametrize("address", ["", "relative", "/nobody/listens/here", "@nobody"])
def test_a_missing_receiver_raises_no_error(address):
    notify("READY=1", {"NOTIFY_SOCKET": address})
