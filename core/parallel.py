"""Work that is shared among the processor's cores, and work that must not be."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Lock
from typing import Any, TypeVar

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


_limit_lock = Lock()
_limits: list[Any] = []  # that of the first block, once for each block that runs


@contextmanager
def blas_in_one_thread() -> Iterator[None]:
    """Keep NumPy's and SciPy's BLAS to one thread within the block, some 1 ms.

    With more a sum depends on how many there are, in its last digits. The limit is that of the
    process: of blocks at a time the last one that ends restores what was before the first.
    """
    import scipy.linalg  # noqa: F401 - loads SciPy's own library, which is not limited later
    from threadpoolctl import threadpool_limits  # no answer needs it: decision 33

    with _limit_lock:
        _limits.append(_limits[0] if _limits else threadpool_limits(1, user_api="blas"))
    try:
        yield
    finally:
        with _limit_lock:
            limit = _limits.pop()
            if not _limits:
                limit.restore_original_limits()
