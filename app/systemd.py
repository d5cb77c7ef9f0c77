"""Messages to a service manager: that the service is ready, and that its event loop runs."""

import asyncio
import os
import socket
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress


def notify(message: str, environment: Mapping[str, str] = os.environ) -> None:
    """Send a message of sd_notify(3), as `READY=1`; without a manager nothing is sent.

    Examples:
        >>> notify("READY=1", {})
    """
    address = environment.get("NOTIFY_SOCKET", "")
    if not address.startswith(("/", "@")):
        return
    if address.startswith("@"):  # Linux' abstract name
        address = "\0" + address[1:]
    kind = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK  # a hung manager does not block the service
    with suppress(OSError), socket.socket(socket.AF_UNIX, kind) as sending:
        sending.sendto(message.encode(), address)


@asynccontextmanager
async def supervised(environment: Mapping[str, str] = os.environ) -> AsyncIterator[None]:
    """Report that the service is ready, and then regularly that the event loop still runs.

    The messages are sent from the loop: if it is blocked they stop, and the manager restarts the
    service (`WatchdogSec` in the unit).
    """
    interval_s = _interval_s(environment)
    notify("READY=1", environment)
    beating = None if interval_s is None else asyncio.create_task(_beat(interval_s, environment))
    try:
        yield
    finally:
        notify("STOPPING=1", environment)
        if beating is not None:
            beating.cancel()


async def _beat(interval_s: float, environment: Mapping[str, str]) -> None:
    while True:
        notify("WATCHDOG=1", environment)
        await asyncio.sleep(interval_s)


def _interval_s(environment: Mapping[str, str]) -> float | None:
    """Return the interval of the messages, half of the manager's timeout as it recommends."""
    microseconds = environment.get("WATCHDOG_USEC", "")
    meant_for = environment.get("WATCHDOG_PID", str(os.getpid()))
    if not microseconds.isdecimal() or meant_for != str(os.getpid()):
        return None
    return max(int(microseconds) / 2e6, 0.01)
