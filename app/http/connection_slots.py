"""Which connection is closed for a new one where all are taken."""

import logging
import math
import time
from collections.abc import Callable, Iterator
from typing import Protocol

_log = logging.getLogger("tensormap.connections")

_UNREAD_WHERE_FULL_S = 5.0  # of a client that reads little of an answer
_LOGGED_EVERY_S = 10.0


class Closable(Protocol):
    """What has a slot: a connection."""

    def close_now(self) -> None:
        """Close it at once, also if its peer has not read everything."""


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
        self._fresh: dict[Closable, None] = {}
        self._kept: dict[Closable, None] = {}
        self._answered: dict[Closable, None] = {}
        self._unread: dict[Closable, float] = {}  # since when
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

    def idle(self, connection: Closable, *, used: bool) -> None:
        """Add a connection that is idle from now on; `used` if it ever sent a request."""
        (self._kept if used else self._fresh)[connection] = None

    def busy(self, connection: Closable) -> None:
        """Note that a connection is used."""
        self._fresh.pop(connection, None)
        self._kept.pop(connection, None)

    def answered(self, connection: Closable) -> None:
        """Note that a connection's last answer is sent; it is closed once its client is done."""
        self._answered[connection] = None

    def unread(self, connection: Closable) -> None:
        """Note that a client reads an answer slower than it is sent."""
        self._unread[connection] = self._clock()

    def read(self, connection: Closable) -> None:
        """Note that a client has read most of what was sent."""
        self._unread.pop(connection, None)

    def gone(self, connection: Closable) -> None:
        """Remove a connection that is closed."""
        self.busy(connection)
        self.read(connection)
        self._answered.pop(connection, None)

    def _hung(self) -> Iterator[Closable]:
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
