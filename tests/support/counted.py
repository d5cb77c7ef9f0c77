"""A port that leads to a service and counts what is sent to it."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress


class Counted:
    """A port that leads to a service and counts the bytes that are sent to it."""

    def __init__(self, port: int) -> None:
        self._to, self._changed = port, threading.Condition()
        self._held_at: int | None = None
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self.sent_bytes = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):  # closed
            while True:
                client, _ = self._listener.accept()
                service = socket.create_connection(("127.0.0.1", self._to))
                for ends in ((client, service, True), (service, client, False)):
                    threading.Thread(target=self._copy, args=ends, daemon=True).start()

    def _copy(self, source: socket.socket, to: socket.socket, counted: bool) -> None:
        with suppress(OSError):
            while piece := source.recv(2**16):
                if counted and not self._may_pass(len(piece)):
                    break
                to.sendall(piece)
        for end in (source, to):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()

    def _may_pass(self, size_bytes: int) -> bool:
        """Count what is sent, or wait until it is dropped with its connection."""
        with self._changed:
            if self._held_at is not None and self.sent_bytes >= self._held_at:
                self._changed.wait_for(lambda: self._held_at is None)
                return False
            self.sent_bytes += size_bytes
            return True

    def hold_at(self, size_bytes: int) -> None:
        """Once so much was sent, let no more pass."""
        with self._changed:
            self._held_at = size_bytes

    def drop_held(self) -> None:
        """Close the connections on which something was held, and let all others pass."""
        with self._changed:
            self._held_at = None
            self._changed.notify_all()

    def reached(self, size_bytes: int) -> bool:
        return self.sent_bytes >= size_bytes

    def close(self) -> None:
        self._listener.close()


@contextmanager
def counting(port: int) -> Iterator[Counted]:
    counted = Counted(port)
    try:
        yield counted
    finally:
        counted.close()
