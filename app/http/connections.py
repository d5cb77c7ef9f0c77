"""Connections: so many at once, those that do nothing closed first, none that never asks.

Uvicorn bounds no connections and gives a request's head no time. What is here goes between its
protocol, of whichever parser, and the loop.
"""

import asyncio
import logging
import resource
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import uvicorn
from uvicorn.protocols.http.auto import AutoHTTPProtocol

from app.http.errors import TooManyConnections
from app.http.problems import problem_response
from app.process import collect_seldom
from app.settings import Settings

if TYPE_CHECKING:
    from uvicorn.protocols.http.h11_impl import H11Protocol as UvicornProtocol
else:
    UvicornProtocol = object

_log = logging.getLogger("tensormap.connections")

_MOST_BY_DEFAULT = 4096  # more take memory (some 20 KB each), not descriptors
_SPARE_DESCRIPTORS = 512  # for files, the catalog's pool, builds, and what is accepted at once
_BACKLOG = 2048  # connections that wait to be taken; Uvicorn's own
_TAKEN_AT_ONCE = 64  # before the loop does anything else; each takes a descriptor
_UNREAD_S = 120  # that a peer may leave what it was sent without taking any of it
_TOLD_EVERY_S = 10.0


def within_descriptors(settings: Settings) -> Settings:
    """Return the settings with as many connections and streams as this process can have open.

    The soft limit of descriptors is raised to the hard one. Half of the connections may be streams,
    half of those of one key: what no client of that key ever closes leaves room for others.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        with suppress(OSError, ValueError):  # a system that allows less than it says
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    endless = soft == resource.RLIM_INFINITY
    room = _MOST_BY_DEFAULT if endless else max(soft - min(_SPARE_DESCRIPTORS, soft // 2), 8)
    wanted = settings.max_connections or min(room, _MOST_BY_DEFAULT)
    if wanted > room and not endless:
        _log.warning(
            "%d descriptors allow %d connections, not %d: raise `ulimit -n`", soft, room, wanted
        )
        wanted = room
    streams = max(min(settings.max_streams, wanted // 2), 1)
    chosen = {
        "max_connections": wanted,
        "max_streams": streams,
        "max_streams_per_key": max(min(settings.max_streams_per_key, streams // 2), 1),
    }
    return settings.model_copy(update=chosen)


def connection_options(settings: Settings) -> dict[str, Any]:
    """Return the options of Uvicorn's `Config` that bound connections.

    Args:
        settings: Of `within_descriptors`.
    """
    slots = ConnectionSlots(settings.max_connections)
    protocol = bounded(AutoHTTPProtocol, slots, settings.request_head_s)
    return {"http": protocol, "backlog": _TAKEN_AT_ONCE}


def close_unread(listening: socket.socket) -> None:
    """Have the system end connections whose peer takes nothing of an answer for two minutes."""
    if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux; what is accepted inherits it
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNREAD_S * 1000)


class BoundedServer(uvicorn.Server):
    """A server that takes a few connections at a time and lets many wait.

    To asyncio both are `backlog`.
    """

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, with a longer queue; what is loaded by then is no garbage."""
        await super().startup(sockets)
        collect_seldom()
        for listening in sockets or ():
            listening.listen(_BACKLOG)


class ConnectionSlots:
    """Which connections do nothing, those first that may be closed first.

    First go those that never sent a request, then those that are kept for another one; of either
    the one that has been idle for longest.

    Args:
        limit: How many connections may be open.
        clock: Seconds that never go back.
    """

    def __init__(self, limit: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._limit = limit
        self._clock = clock
        self._fresh: dict[BoundedConnection, None] = {}
        self._kept: dict[BoundedConnection, None] = {}
        self._refused = self._closed = 0
        self._told_at: float | None = None

    def has_room(self, open_now: int) -> bool:
        """Return whether one of so many connections may stay; an idle one is closed for it."""
        if open_now <= self._limit:
            return True
        idle = next(iter(self._fresh or self._kept), None)
        if idle is None:
            self._refused += 1
        else:
            self._closed += 1
            self.busy(idle)
            idle.give_way()
        self._tell()
        return idle is not None

    def waits(self, connection: "BoundedConnection", *, asked: bool) -> None:
        """Note that a connection does nothing from now on.

        Args:
            connection: Which.
            asked: Whether it ever sent a request.
        """
        (self._kept if asked else self._fresh)[connection] = None

    def busy(self, connection: "BoundedConnection") -> None:
        """Note that a connection does something, or is gone."""
        self._fresh.pop(connection, None)
        self._kept.pop(connection, None)

    def _tell(self) -> None:
        now_s = self._clock()
        if self._told_at is not None and now_s - self._told_at < _TOLD_EVERY_S:
            return
        self._told_at = now_s
        _log.warning(
            "%d connections are open, as many as may be: %d idle ones were closed for others, %d"
            " were refused",
            self._limit,
            self._closed,
            self._refused,
        )
        self._refused = self._closed = 0


class BoundedConnection(UvicornProtocol):
    """What a connection does besides, with Uvicorn's protocol of either parser as its base.

    Attributes:
        slots: Those of the server.
        head_s: Seconds in which a request's head is to come, from its first byte or, the first one,
            from the connection's start.
    """

    slots: ConnectionSlots
    head_s: float
    _late: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a place, or refuse the connection."""
        super().connection_made(transport)
        if self.slots.has_room(len(self.connections)):
            self.slots.waits(self, asked=False)
            self._expect_head()
        else:
            transport.write(_refusal())
            transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place back."""
        self._leave()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Note whether a request is under way now."""
        super().data_received(data)
        if self.transport.is_closing() or self.transport.get_protocol() is not self:
            self._leave()  # refused, or a WebSocket from now on
        elif self._is_busy():
            self._leave()
        elif self._late is None and (self.cycle is None or not self.cycle.more_body):
            self._expect_head()

    def on_response_complete(self) -> None:
        """Note that the connection is kept for another request, unless that is there already."""
        super().on_response_complete()
        if not self.transport.is_closing() and not self._is_busy():
            self.slots.waits(self, asked=True)

    def give_way(self) -> None:
        """Close an idle connection now, whatever it has not read yet."""
        self._leave()
        self.connections.discard(self)  # it is counted no more
        self.transport.abort()

    def _is_busy(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _expect_head(self) -> None:
        self._late = self.loop.call_later(self.head_s, self._too_late)

    def _too_late(self) -> None:
        self._leave()
        if not self._is_busy():
            self.transport.close()

    def _leave(self) -> None:
        self.slots.busy(self)
        if self._late is not None:
            self._late.cancel()
            self._late = None


def bounded(
    protocol: type[asyncio.Protocol], slots: ConnectionSlots, head_s: float
) -> type[asyncio.Protocol]:
    """Return a protocol of Uvicorn's whose connections are bounded."""
    own = {"slots": slots, "head_s": head_s}
    return type(f"Bounded{protocol.__name__}", (BoundedConnection, protocol), own)


def _refusal() -> bytes:
    """Return an answer to whatever a connection would have asked."""
    answer = problem_response(
        TooManyConnections("as many connections are open as may be, each in use: try again soon")
    )
    fields = b"".join(b"%b: %b\r\n" % field for field in answer.raw_headers)
    return b"HTTP/1.1 503 Service Unavailable\r\n" + fields + b"\r\n" + bytes(answer.body)
