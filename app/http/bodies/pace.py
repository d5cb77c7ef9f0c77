"""How slowly a body may come: never idle for long, and no slower than a least rate."""

import asyncio
import time
from collections.abc import Callable

from starlette.types import Message, Receive

from app.http.errors import SlowBody
from app.settings import Settings


class Pace:
    """Waits for the parts of one body; time that we take ourselves between two does not count.

    A body may lag behind the least rate by what that rate sends in the grace; how fast it was
    before earns no more than that. There is no total time.

    Args:
        settings: Its `body_idle_s`, `body_grace_s` and `body_bytes_per_s`.
        clock: Seconds that never go back.

    Raises:
        SlowBody: While it waits, if the body is slower.
    """

    def __init__(self, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        self._idle_s = settings.body_idle_s
        self._rate = settings.body_bytes_per_s
        self._most_left = self._rate * settings.body_grace_s
        self._left = self._most_left
        self._clock = clock

    async def next(self, receive: Receive) -> Message:
        """Return the next part of the body."""
        patience_s = self._idle_s
        if self._rate:
            patience_s = min(patience_s, self._left / self._rate)
        began = self._clock()
        try:
            async with asyncio.timeout(patience_s):
                message = await receive()
        except TimeoutError:
            raise self._too_slow(patience_s) from None
        lag = (self._clock() - began) * self._rate
        self._left = min(self._most_left, self._left - lag + len(message.get("body", b"")))
        return message

    def _too_slow(self, waited_s: float) -> SlowBody:
        if waited_s >= self._idle_s:
            return SlowBody(f"nothing of the body came for {self._idle_s:g} s")
        return SlowBody(
            f"the body comes slower than {self._rate:g} bytes a second, the least that may be"
        )
