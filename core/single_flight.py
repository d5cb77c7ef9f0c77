"""Values of a function, each computed by one thread while others wait for it."""

import threading
from collections.abc import Callable, Hashable
from functools import lru_cache
from typing import Generic, TypeVar

T = TypeVar("T")


class SingleFlight(Generic[T]):
    """A function whose values of the last arguments are kept.

    As `functools.lru_cache`, which computes a value once in each thread that needs it meanwhile.

    Args:
        compute: The function.
        kept: Of how many arguments values are kept.

    Examples:
        >>> squares = SingleFlight(lambda x: x * x, kept=2)
        >>> squares(3)
        9
    """

    def __init__(self, compute: Callable[..., T], kept: int) -> None:
        self._compute = compute
        self._lock = threading.Lock()
        self._values: Callable[..., _Value[T]] = lru_cache(kept)(lambda *_: _Value())

    def __call__(self, *arguments: Hashable) -> T:
        """Return the value of some arguments."""
        with self._lock:
            value = self._values(*arguments)
        with value.lock:
            if not value.computed:
                value.computed.append(self._compute(*arguments))
        return value.computed[0]


class _Value(Generic[T]):
    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.computed: list[T] = []  # one, or none yet
