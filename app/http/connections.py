"""Limits of a connection: the time and size of a request's head, and whether it may stay.

Uvicorn limits none of these with its compiled parser. This module goes between its protocol and the
loop.
"""

import asyncio

import httptools
from uvicorn._types import ASGI3Application
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from app.http.bodies.unread import ANSWERED
from app.http.connection_slots import ConnectionSlots
from app.http.errors import TooManyConnections
from app.http.logs import MALFORMED
from app.http.peers import plain_peer
from app.http.problems import problem_response

_HEAD_BYTES = 64 * 2**10  # of a head, or between two parts of a body
_PIPELINED = 8  # requests that wait for the answer to the one before, on one connection
_OF_UPGRADES = {b"upgrade", b"http2-settings"}  # fields


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
