"""Streams that are open: of tracks, and of jobs' events."""

import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from anyio import CapacityLimiter

from app.errors import TooManyStreams, TooManyStreamsOfKey

__all__ = ["Streams"]

_OPENED_AT_ONCE = 4


class Streams:
    """Counts the open streams of all keys and of each; safe to share between threads.

    Args:
        limit: How many may be open.
        per_key: How many may be open of one key.

    Attributes:
        opening: Limits the threads that check who opens a stream: thousands that come at once leave
            the others to requests.

    Examples:
        >>> streams = Streams(limit=3, per_key=1)
        >>> with streams.opened("a"), streams.opened("a"):
        ...     pass
        Traceback (most recent call last):
        app.errors.TooManyStreamsOfKey: 1 streams of key a are open, as many as may be: close one
        >>> len(streams)
        0
    """

    def __init__(self, limit: int, per_key: int) -> None:
        self._limit = limit
        self._per_key = per_key
        self._open: Counter[str] = Counter()
        self._lock = threading.Lock()
        self.opening = CapacityLimiter(_OPENED_AT_ONCE)

    def __len__(self) -> int:
        with self._lock:
            return self._open.total()

    @contextmanager
    def opened(self, key_id: str) -> Iterator[None]:
        """Count a stream of a key for as long as the block runs.

        Raises:
            TooManyStreamsOfKey: If as many of this key are open as may be.
            TooManyStreams: If as many of all keys are.
        """
        self._take(key_id)
        try:
            yield
        finally:
            self._give_back(key_id)

    def _take(self, key_id: str) -> None:
        with self._lock:
            if self._open[key_id] >= self._per_key:
                raise TooManyStreamsOfKey(
                    f"{self._per_key} streams of key {key_id} are open, as many as may be:"
                    " close one"
                )
            if self._open.total() >= self._limit:
                raise TooManyStreams(
                    f"{self._limit} streams are open, as many as may be: post observations one by"
                    " one, or ask again"
                )
            self._open[key_id] += 1

    def _give_back(self, key_id: str) -> None:
        with self._lock:
            self._open[key_id] -= 1
            if not self._open[key_id]:
                del self._open[key_id]
