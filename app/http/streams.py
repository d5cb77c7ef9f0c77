"""Open streams: of tracks, and of jobs' events."""

import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from app.http.errors import TooManyStreams, TooManyStreamsOfKey
from core.text import count_of


class Streams:
    """Counts the open streams of all keys and of each; safe to share between threads.

    Args:
        limit: How many may be open.
        per_key: How many may be open of one key.

    Examples:
        >>> streams = Streams(limit=3, per_key=1)
        >>> with streams.opened("a"), streams.opened("a"):
        ...     pass
        Traceback (most recent call last):
        app.http.errors.TooManyStreamsOfKey: key a has reached the limit of 1 open stream: ...
        >>> len(streams)
        0
    """

    def __init__(self, limit: int, per_key: int) -> None:
        self._limit = limit
        self._per_key = per_key
        self._open: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._open_with: Counter[str] = Counter()

    def __len__(self) -> int:
        with self._lock:
            return self._open.total()

    def require_room(self, secret_hash: str) -> None:
        """Reject a stream that `opened` would reject, without reading the catalog.

        Args:
            secret_hash: The hash of the key or token that was sent, valid or not.

        Raises:
            TooManyStreamsOfKey: If the key's limit of open streams is reached.
        """
        with self._lock:
            if self._open_with[secret_hash] >= self._per_key:
                raise TooManyStreamsOfKey(
                    f"the limit of {self._per_key} open streams of a key is reached: close one"
                )

    @contextmanager
    def opened(self, key_id: str, secret_hash: str = "") -> Iterator[None]:
        """Count a stream of a key while the block runs.

        Args:
            key_id: The id of the stream's key.
            secret_hash: The hash of the key or token that was sent, for `require_room`.

        Raises:
            TooManyStreamsOfKey: If the key's limit of open streams is reached.
            TooManyStreams: If the service's limit of open streams is reached.
        """
        with self._lock:
            if self._open[key_id] >= self._per_key:
                raise TooManyStreamsOfKey(
                    f"key {key_id} has reached the limit of "
                    f"{count_of(self._per_key, 'open stream')}: close one"
                )
            if self._open.total() >= self._limit:
                raise TooManyStreams(
                    f"the limit of {self._limit} open streams of the service is reached: post"
                    " observations one by one, or try again later"
                )
            self._open[key_id] += 1
            self._open_with[secret_hash] += 1
        try:
            yield
        finally:
            with self._lock:
                for counted, of in ((self._open, key_id), (self._open_with, secret_hash)):
                    counted[of] -= 1
                    if not counted[of]:
                        del counted[of]
