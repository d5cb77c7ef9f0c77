"""Rate limits of each key: token buckets, of requests or of bytes sent."""

import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from app.http.answer_headers import LIMIT, POLICY
from app.http.errors import TooManyRequests

# The least recently used one is dropped; should its owner return, it is full, as it mostly was.
_MOST_BUCKETS = 10_000


@dataclass(frozen=True)
class Unit:
    """Unit of a bucket.

    Attributes:
        name: The policy's name in the header fields.
        policy: Parameters of the policy's field, after its name.
        allowed: Describes the limit, from a rate a second and the size of a full bucket.
    """

    name: str
    policy: str
    allowed: Callable[[float, int], str]


REQUESTS = Unit(
    "requests",
    "",
    lambda rate, burst: f"{rate:g} request{'s' * (rate != 1)} a second, {burst} at once,",
)
BYTES = Unit(
    "bytes", ';qu="content-bytes"', lambda _, burst: f"{burst} bytes of bodies and messages a day"
)


@dataclass
class _Bucket:
    left: float
    at_s: float


class RateLimits:
    """A bucket for each key; safe to share between threads.

    Args:
        per_s: How fast a bucket fills up; 0 limits nothing.
        burst: Size of a full one.
        clock: Monotonic clock, in seconds.
        unit: The unit of the rate.

    Examples:
        >>> limits = RateLimits(2.0, 3, clock=lambda: 0.0)
        >>> [limits.take("fleet")["RateLimit"] for _ in range(3)]
        ['"requests";r=2;t=1', '"requests";r=1;t=1', '"requests";r=0;t=2']
        >>> limits.take("fleet")
        Traceback (most recent call last):
        app.http.errors.TooManyRequests: 2 requests a second, 3 at once, are allowed: wait 1 s
    """

    def __init__(
        self,
        per_s: float,
        burst: int,
        clock: Callable[[], float] = time.monotonic,
        unit: Unit = REQUESTS,
    ) -> None:
        self._rate = per_s
        self._unit = unit
        self._burst = burst
        self._clock = clock
        self._buckets: OrderedDict[str, _Bucket] = OrderedDict()
        self._lock = threading.Lock()

    def never_allows(self, amount: int) -> bool:
        """Return whether not even a full bucket holds this much."""
        return self._rate > 0 and amount > self._burst

    def take(self, who: str, amount: int = 1) -> dict[str, str]:
        """Take out of a bucket, and return the header fields of what is left, none without a limit.

        Args:
            who: The bucket's owner.
            amount: How much.

        Raises:
            TooManyRequests: If it has less; nothing is taken.
        """
        if self._rate == 0:
            return {}
        with self._lock:
            bucket = self._with_room(who, amount)
            bucket.left -= amount
            return self._headers(bucket)

    def require(self, who: str, amount: int) -> dict[str, str]:
        """Require that a bucket has as much, and return the header fields as `take`; take nothing.

        Raises:
            TooManyRequests: If it has less.
        """
        if self._rate == 0:
            return {}
        with self._lock:
            return self._headers(self._with_room(who, amount))

    def _with_room(self, who: str, amount: int) -> _Bucket:
        bucket = self._filled(who)
        if bucket.left < amount:
            # More than a full bucket must be sent in parts: the next when it is full.
            wait_s = max(1, math.ceil((min(amount, self._burst) - bucket.left) / self._rate))
            raise TooManyRequests(
                f"{self._unit.allowed(self._rate, self._burst)} are allowed: wait {wait_s} s",
                wait_s,
                self._headers(bucket),
            )
        return bucket

    def _filled(self, who: str) -> _Bucket:
        now_s = self._clock()
        bucket = self._buckets.pop(who, None) or _Bucket(self._burst, now_s)
        grown = bucket.left + (now_s - bucket.at_s) * self._rate
        bucket.left, bucket.at_s = min(self._burst, grown), now_s
        self._buckets[who] = bucket
        if len(self._buckets) > _MOST_BUCKETS:
            self._buckets.popitem(last=False)
        return bucket

    def _headers(self, bucket: _Bucket) -> dict[str, str]:
        """Return what is left, as in the IETF's draft `RateLimit header fields for HTTP`."""
        name, rate = self._unit.name, self._rate
        window_s = _rounded_up(self._burst / rate)
        full_in_s = _rounded_up((self._burst - bucket.left) / rate)
        return {
            POLICY: f'"{name}";q={self._burst}{self._unit.policy};w={window_s}',
            LIMIT: f'"{name}";r={int(bucket.left)};t={full_in_s}',
        }


def _rounded_up(seconds: float) -> int:
    """Return whole seconds, at least as long but for a microsecond, which is rounding.

    Examples:
        >>> daily = 3_000_000_000
        >>> math.ceil(daily / (daily / 86_400)), _rounded_up(daily / (daily / 86_400))
        (86401, 86400)
    """
    return math.ceil(round(seconds, 6))
