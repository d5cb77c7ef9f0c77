"""WebSockets whose first request is refused with an answer.

Uvicorn leaves one that `websockets` cannot read, as with a body or more than 128 fields, open for
ever and without an answer, and then a stop of the service fails.
"""

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol


class BoundedWebSocket(WebSocketsSansIOProtocol):
    """A connection from the head that asks for a WebSocket on."""

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
