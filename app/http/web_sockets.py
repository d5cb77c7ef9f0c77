"""WebSockets whose first request is refused with an answer, and which take a bounded memory.

Uvicorn leaves one that `websockets` cannot read, as with a body or more than 128 fields, open for
ever and without an answer, and then a stop of the service fails.

Uvicorn reads nothing more while a message waits for its answer. So a connection has in memory what
one read of the socket brought, 256 kB at most, and one message of `ws_max_size` that is incomplete.
Neither counts parts of a message that have no bytes, or pongs that the client does not read: this
module does.
"""

import asyncio

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import CloseCode, Frame

from app.http.peers import plain_peer

_MOST_PARTS = 4096  # of a message, or as many as have 1 KB each in the largest one
_UNREAD_BYTES = 2**20  # of pongs and answers; the largest answer is some KB, and waits for others


class BoundedWebSocket(WebSocketsSansIOProtocol):
    """A connection from the head that asks for a WebSocket on."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as Uvicorn
        """Take over a connection."""
        super().connection_made(transport)
        self.client = plain_peer(self.client)

    def handle_cont(self, event: Frame) -> None:
        """Receive a part of a message; one of very many closes the stream."""
        most = max(_MOST_PARTS, self.config.ws_max_size // 2**10)
        if len(self.frames) < most:
            super().handle_cont(event)
        elif not self.close_sent:
            self.frames.clear()
            self.conn.fail(CloseCode.MESSAGE_TOO_BIG, f"a message has more than {most} parts")
            self.handle_parser_exception()

    def handle_ping(self) -> None:
        """Answer a ping; a client that sends pings and reads no pong is cut off."""
        super().handle_ping()
        if self.transport.get_write_buffer_size() > _UNREAD_BYTES:
            self.transport.abort()

    def data_received(self, data: bytes) -> None:
        """Receive the head, which comes first and whole, or messages."""
        super().data_received(data)
        if self.handshake_initiated or self.transport.is_closing():
            return
        self.handshake_complete = self.close_sent = True  # nothing is left to send at a stop
        self.transport.write(b"".join(self.conn.data_to_send()) or self._refusal())
        self.transport.close()

    def _refusal(self) -> bytes:
        wrong = self.conn.handshake_exc
        reason = wrong.__cause__ or wrong if wrong else "it is incomplete"
        text = f"the request for a WebSocket cannot be read: {reason}"
        head = (
            "HTTP/1.1 400 Bad Request\r\ncontent-type: text/plain; charset=utf-8\r\n"
            f"content-length: {len(text)}\r\nconnection: close\r\n\r\n"
        )
        return (head + text).encode("ascii", "replace")
