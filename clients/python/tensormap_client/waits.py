"""Waits between attempts, which differ from client to client."""

import random

LONGEST_ASKED_S = 20.0
"""The most of a `Retry-After` that is obeyed: a page of a proxy often asks for an hour.

With the random part of `Waits.next_s` it is half a minute.
"""


class Waits:
    """Waits between attempts, each up to twice as long as the one before.

    Clients that lost a service together do not return together: a wait is from half of its length
    to all of it, and one that the service asked for is up to half as long again.

    Args:
        first_s: The longest that the first wait may be, in seconds.
        longest_s: The longest that any of them may be, if the service does not say.
    """

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self._wait_s = first_s

    def next_s(self, asked_s: float = 0.0) -> float:
        """Return how long to wait now, in seconds, and not less than the service asked for."""
        wait_s = self._wait_s * random.uniform(0.5, 1.0)  # noqa: S311 - no secret
        self._wait_s = min(2.0 * self._wait_s, self._longest_s)
        return max(wait_s, asked_s * random.uniform(1.0, 1.5))  # noqa: S311 - no secret

    def begin_again(self) -> None:
        """Begin with the first wait again, as after an answer."""
        self._wait_s = self._first_s
