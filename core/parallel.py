"""Work that is shared among the processor's cores."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def usable_cores() -> int:
    """Return how many cores this process may use, at least 1."""
    if hasattr(os, "sched_getaffinity"):  # elsewhere it may use all
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_threads(function: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """Return the function's results of all items, as many at a time as there are cores.

    Args:
        function: One that spends its time outside of the interpreter.
        items: What it is called with.

    Examples:
        >>> in_threads(abs, [1, -2])
        [1, 2]
    """
    threads = min(usable_cores(), len(items))
    if threads <= 1:
        return [function(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, items))
