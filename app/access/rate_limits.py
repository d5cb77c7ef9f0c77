"""How often each key may ask: a bucket of requests that fills up again."""

import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from app.errors import TooManyRequests

__all__ = ["NO_LIMITS", "Allowance", "RateLimits"]

# The one used longest ago goes first; should its owner come back, it is full, as it mostly was.
_MOST_BUCKETS = 10_000
_NAME = '"requests"'


@dataclass(frozen=True)
class Allowance:
    """What is left to whoever asked.

    Attributes:
        burst: Requests in a full bucket.
        window_s: Seconds in which an empty one fills up, rounded up.
        remaining: Requests that are left in it.
        full_in_s: Seconds until it is full again, rounded up.
    """

    burst: int
    window_s: int
    remaining: int
    full_in_s: int

    def headers(self) -> dict[str, str]:
        """Return the fields of the IETF's draft `RateLimit header fields for HTTP`."""
        return {
            "RateLimit-Policy": f"{_NAME};q={self.burst};w={self.window_s}",
            "RateLimit": f"{_NAME};r={self.remaining};t={self.full_in_s}",
        }


@dataclass
class _Bucket:
    requests: float
    at_s: float


class RateLimits:
    """A bucket for each key; safe to share between threads.

    Args:
        requests_per_s: How fast a bucket fills up; 0 limits nothing.
        burst: How many requests a full one holds.
        clock: Seconds that never go back.

    Examples:
        >>> limits = RateLimits(2.0, 3, clock=lambda: 0.0)
        >>> [limits.take("fleet").remaining for _ in range(3)]
        [2, 1, 0]
        >>> limits.take("fleet")
        Traceback (most recent call last):
        app.errors.TooManyRequests: 2 requests a second, 3 at once, are allowed: wait 1 s
    """

    def __init__(
        self, requests_per_s: float, burst: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate = requests_per_s
        self._burst = burst
        self._clock = clock
        self._buckets: OrderedDict[str, _Bucket] = OrderedDict()
        self._lock = threading.Lock()

    def take(self, who: str) -> Allowance | None:
        """Take a request out of a bucket; `None` if nothing is limited.

        Raises:
            TooManyRequests: If it has none.
        """
        if self._rate == 0:
            return None
        with self._lock:
            bucket = self._filled(who)
            if bucket.requests < 1:
                wait_s = max(1, math.ceil((1 - bucket.requests) / self._rate))
                raise TooManyRequests(
                    f"{self._rate:g} requests a second, {self._burst} at once, are allowed:"
                    f" wait {wait_s} s",
                    wait_s,
                    self._allowance(bucket).headers(),
                )
            bucket.requests -= 1
            return self._allowance(bucket)

    def _filled(self, who: str) -> _Bucket:
        now_s = self._clock()
        bucket = self._buckets.pop(who, None) or _Bucket(self._burst, now_s)
        grown = bucket.requests + (now_s - bucket.at_s) * self._rate
        bucket.requests, bucket.at_s = min(self._burst, grown), now_s
        self._buckets[who] = bucket
        if len(self._buckets) > _MOST_BUCKETS:
            self._buckets.popitem(last=False)
        return bucket

    def _allowance(self, bucket: _Bucket) -> Allowance:
        return Allowance(
            self._burst,
            math.ceil(self._burst / self._rate),
            int(bucket.requests),
            math.ceil((self._burst - bucket.requests) / self._rate),
        )


NO_LIMITS = RateLimits(0.0, 1)
