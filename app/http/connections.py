"""Limits of connections: their number, and the time and size of a request's head.

Uvicorn limits none of these with its compiled parser. This module goes between its protocol and the
loop.
"""

import asyncio
import logging
import math
import resource
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import httptools
import uvicorn
from uvicorn._types import ASGI3Application
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from app.http.bodies.unread import ANSWERED
from app.http.errors import TooManyConnections
from app.http.logs import MALFORMED
from app.http.peers import plain_peer
from app.http.problems import problem_response
from app.http.web_sockets import BoundedWebSocket
from app.process import collect_seldom
from app.settings import Settings

_log = logging.getLogger("tensormap.connections")

_MOST_BY_DEFAULT = 4096  # more take memory (some 20 KB each), not descriptors
_SPARE_DESCRIPTORS = 512  # for files, the catalog's pool, builds, and connections being accepted
_BACKLOG = 2048  # connections that wait to be accepted; Uvicorn's own default
_ACCEPTED_AT_ONCE = 64  # before the loop does anything else; each takes a descriptor
_HEAD_BYTES = 64 * 2**10  # of a head, or between two parts of a body
_PIPELINED = 8  # requests that wait for the answer to the one before, on one connection
_UNREAD_S = 120  # that a peer may receive nothing of an answer
_UNREAD_WHERE_FULL_S = 5.0  # that it may receive little of one, where others need the connection
_OF_UPGRADES = {b"upgrade", b"http2-settings"}  # fields
_LOGGED_EVERY_S = 10.0


def within_descriptors(settings: Settings) -> Settings:
    """Return the settings with as many connections and streams as this process can have open.

    The soft limit of descriptors is raised to the hard one. Half of the connections may be streams,
    half of these of one key: streams that a client never closes leave room for others.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        with suppress(OSError, ValueError):  # some systems allow less than the hard limit
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    endless = soft == resource.RLIM_INFINITY
    room = _MOST_BY_DEFAULT if endless else max(soft - min(_SPARE_DESCRIPTORS, soft // 2), 8)
    connections = settings.max_connections or min(room, _MOST_BY_DEFAULT)
    if connections > room and not endless:
        _log.warning(
            "%d descriptors allow %d connections, not %d: raise `ulimit -n`",
            soft,
            room,
            connections,
        )
        connections = room
    streams = max(min(settings.max_streams, connections // 2), 1)
    chosen = {
        "max_connections": connections,
        "max_streams": streams,
        "max_streams_per_key": max(min(settings.max_streams_per_key, streams // 2), 1),
    }
    return settings.model_copy(update=chosen)


def connection_options(settings: Settings) -> dict[str, Any]:
    """Return the options of Uvicorn's `Config` that bound connections.

    Args:
        settings: The settings from `within_descriptors`.
    """
    slots = ConnectionSlots(settings.max_connections)
    limits = {"slots": slots, "head_s": settings.request_head_s}
    protocol = type("BoundedProtocol", (BoundedConnection,), limits)
    return {
        "loop": "uvloop",
        "http": protocol,
        "ws": BoundedWebSocket,
        "backlog": _ACCEPTED_AT_ONCE,
    }


def close_unread(listening: socket.socket) -> None:
    """Let the system end connections whose peer receives nothing of an answer for two minutes."""
    if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux; accepted connections inherit it
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNREAD_S * 1000)


class BoundedServer(uvicorn.Server):
    """A server that accepts a few connections at a time and lets many wait.

    asyncio uses `backlog` for both.

    Args:
        config: Of Uvicorn.
        stopping: Called on the event loop when the server begins to stop: it ends answers that
            would last longer than a stop waits for them.
    """

    def __init__(self, config: uvicorn.Config, stopping: Callable[[], None] = lambda: None) -> None:
        super().__init__(config)
        self._stopping = stopping

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, with a longer queue; everything loaded by then is excluded from collection."""
        await super().startup(sockets)
        collect_seldom()
        for listening in sockets or ():
            listening.listen(_BACKLOG)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop: wait for the answers that are left."""
        self._stopping()
        await super().shutdown(sockets)


class ConnectionSlots:
    """The connections that wait for their clients, in the order in which others replace them.

    First those that never sent a request, then those that are kept for another one, then those
    whose answer is sent and only has to be read, or whose client still sends a body that nobody
    reads; at last those whose client has read little of an answer for some seconds. Of each the one
    that has been so for longest. While there is room none is closed here, however slow its client.

    Args:
        limit: How many connections may be open.
        clock: Monotonic clock, in seconds.
    """

    def __init__(self, limit: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._limit = limit
        self._clock = clock
        self._fresh: dict[BoundedConnection, None] = {}
        self._kept: dict[BoundedConnection, None] = {}
        self._answered: dict[BoundedConnection, None] = {}
        self._unread: dict[BoundedConnection, float] = {}  # since when
        self._refused = self._closed = 0
        self._logged_at_s = -math.inf

    def has_room(self, open_now: int) -> bool:
        """Return whether a new connection may stay; another is closed for it if necessary."""
        if open_now <= self._limit:
            return True
        waiting = next(iter(self._fresh or self._kept or self._answered or self._hung()), None)
        if waiting is None:
            self._refused += 1
        else:
            self._closed += 1
            self.gone(waiting)
            waiting.close_now()
        self._log()
        return waiting is not None

    def idle(self, connection: "BoundedConnection", *, used: bool) -> None:
        """Add a connection that is idle from now on; `used` if it ever sent a request."""
        (self._kept if used else self._fresh)[connection] = None

    def busy(self, connection: "BoundedConnection") -> None:
        """Note that a connection is used."""
        self._fresh.pop(connection, None)
        self._kept.pop(connection, None)

    def answered(self, connection: "BoundedConnection") -> None:
        """Note that a connection's last answer is sent; it is closed once its client is done."""
        self._answered[connection] = None

    def unread(self, connection: "BoundedConnection") -> None:
        """Note that a client reads an answer slower than it is sent."""
        self._unread[connection] = self._clock()

    def read(self, connection: "BoundedConnection") -> None:
        """Note that a client has read most of what was sent."""
        self._unread.pop(connection, None)

    def gone(self, connection: "BoundedConnection") -> None:
        """Remove a connection that is closed."""
        self.busy(connection)
        self.read(connection)
        self._answered.pop(connection, None)

    def _hung(self) -> Iterator["BoundedConnection"]:
        """Yield the one whose client has read little for longest, if that is some seconds."""
        for connection, since_s in self._unread.items():
            if self._clock() - since_s >= _UNREAD_WHERE_FULL_S:
                yield connection
            return  # those behind it have waited for less

    def _log(self) -> None:
        now_s = self._clock()
        if now_s - self._logged_at_s < _LOGGED_EVERY_S:
            return
        self._logged_at_s = now_s
        _log.warning(
            "the limit of %d connections is reached: %d that waited for their clients were closed"
            " for others, %d were refused",
            self._limit,
            self._closed,
            self._refused,
        )
        self._refused = self._closed = 0


class BoundedConnection(HttpToolsProtocol):
    """A connection with limits; `connection_options` makes a class of them.

    Attributes:
        slots: The slots of the server.
        head_s: Seconds for a request's head, from its first byte or, for the first request, from
            the connection's start.
    """

    slots: ConnectionSlots
    head_s: float
    _late: asyncio.TimerHandle | None = None
    _unread_bytes = 0  # of a head that is incomplete, or of what is between two parts of a body
    _running: RequestResponseCycle | None = None  # `cycle` is the newest, which may wait for it

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept the connection, or answer 503 and close it."""
        super().connection_made(transport)
        self.client = plain_peer(self.client)
        if self.slots.has_room(len(self.connections)):
            self.slots.idle(self, used=False)
            self._expect_head()
        else:
            transport.write(_refusal())
            transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove the connection, and mark the running request as disconnected."""
        self._leave()
        self.slots.gone(self)
        self.pipeline.clear()
        if self._running is not None and not self._running.response_complete:
            self._running.disconnected = True
            self._running.message_event.set()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Update whether the connection is in use."""
        self._unread_bytes += len(data)
        self._feed(data)
        if self._unread_bytes > _HEAD_BYTES and not self.transport.is_closing():
            self.send_400_response(f"the head is longer than {_HEAD_BYTES} bytes")
        if self.transport.is_closing() or self.transport.get_protocol() is not self:
            self._leave()  # rejected, or a WebSocket from now on
            if self.transport.is_closing():
                self._answered()
        elif self._is_busy():
            self._leave()
        elif self._late is None and (self.cycle is None or not self.cycle.more_body):
            self._expect_head()

    def pause_writing(self) -> None:
        """Note that the client reads an answer slower than it is sent."""
        super().pause_writing()
        self.slots.unread(self)

    def resume_writing(self) -> None:
        """Note that the client has read most of what was sent."""
        super().resume_writing()
        self.slots.read(self)
        if self.cycle is not None and self.cycle.response_complete:
            self._keep()

    def on_message_begin(self) -> None:
        """Begin a request, which says when it is answered though its body is not read."""
        super().on_message_begin()
        self.scope["extensions"] = {ANSWERED: {"call": self._answered}}

    def on_headers_complete(self) -> None:
        """Begin a request; the parser leaves these checks to us."""
        self._unread_bytes = 0
        hosts = sum(name == b"host" for name, _ in self.headers)
        # RFC 9112: a second one could be meant for whoever is behind or before us.
        if hosts > 1 or (hosts == 0 and self.parser.get_http_version() == "1.1"):
            raise ValueError(f"{hosts} Host fields, wanted one")  # answered with 400
        if len(self.pipeline) >= _PIPELINED:
            raise ValueError(f"more than {_PIPELINED} requests at once")
        if (
            self.parser.should_upgrade()
            and self._should_upgrade()
            and (self._is_busy() or self.transport.get_write_buffer_size())
        ):
            # It would take the connection away from that one, which then waits for its client.
            raise ValueError("a WebSocket before the answer to another request")
        if self._asks_for_another_protocol():
            if not any(name == b"upgrade" for name, _ in self.headers):
                raise ValueError("CONNECT, wanted a request to this service")
            return  # it is parsed again, without asking
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Receive a part of a body."""
        self._unread_bytes = 0
        super().on_body(body)

    def on_message_complete(self) -> None:
        """Note the end of a body."""
        if not self._asks_for_another_protocol():
            super().on_message_complete()

    def on_response_complete(self) -> None:
        """Keep the connection for another request, unless that was received already."""
        super().on_response_complete()
        if self.transport.is_closing():
            self._answered()
        elif not self.flow.write_paused:  # else its client still reads the answer
            self._keep()

    def _keep(self) -> None:
        """Note that the connection is idle, unless another request was received already."""
        if not self.transport.is_closing() and not self._is_busy():
            self.slots.idle(self, used=True)

    def close_now(self) -> None:
        """Close a connection at once, also if its peer has not read everything."""
        self._leave()
        self.connections.discard(self)  # it is no longer counted
        self.transport.abort()

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: ASGI3Application) -> None:
        self._running = cycle
        super()._start_asgi_task(cycle, app)

    def _feed(self, data: bytes) -> None:
        """Parse what was received; a request for a protocol that is not spoken is an ordinary one.

        The parser would skip the body of such a request, as of a Java client that asks for HTTP/2,
        and take it for the next request.
        """
        self._unset_keepalive_if_required()
        try:
            self.parser.feed_data(data)
        except httptools.HttpParserUpgrade as upgrade:
            if self._should_upgrade():
                self.handle_websocket_upgrade()
            else:
                head = self._head_without_upgrade()
                # The one before has ended, and ignores what follows if the head says `close`.
                self.parser = httptools.HttpRequestParser(self)
                self.parser.set_dangerous_leniencies(lenient_data_after_close=True)
                self._feed(head + data[upgrade.args[0] :])
        except httptools.HttpParserError as error:
            self.logger.warning(f"{MALFORMED} ({error.__context__ or error})")
            self.send_400_response(MALFORMED)

    def _asks_for_another_protocol(self) -> bool:
        return self.parser.should_upgrade() and not self._should_upgrade()

    def _head_without_upgrade(self) -> bytes:
        """Return the head that was parsed last, for the parser."""
        method, version = self.parser.get_method(), self.parser.get_http_version().encode()
        fields = [b"%b: %b\r\n" % field for field in self.headers if field[0] not in _OF_UPGRADES]
        return b"%b %b HTTP/%b\r\n%b\r\n" % (method, self.url, version, b"".join(fields))

    def _is_busy(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _expect_head(self) -> None:
        self._late = self.loop.call_later(self.head_s, self._too_late)

    def _too_late(self) -> None:
        self._leave()
        if not self._is_busy():
            self.transport.close()
            self._answered()

    def _answered(self) -> None:
        if self in self.connections:  # else it is closed already
            self.slots.answered(self)

    def _leave(self) -> None:
        self.slots.busy(self)
        if self._late is not None:
            self._late.cancel()
            self._late = None


def _refusal() -> bytes:
    """Return the answer to a connection that is not accepted."""
    answer = problem_response(
        TooManyConnections("the limit of connections is reached and none is idle: try again soon")
    )
    fields = b"".join(b"%b: %b\r\n" % field for field in answer.raw_headers)
    return b"HTTP/1.1 503 Service Unavailable\r\n" + fields + b"\r\n" + bytes(answer.body)
