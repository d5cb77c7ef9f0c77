"""Work of some milliseconds, which the event loop does itself.

In a thread it would wait for the interpreter's lock at each of its dozens of small arrays.
"""

import threading
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TypeVar

from app.loading import NotLoaded, without_loading
from storage.catalog import NotKept

T = TypeVar("T")

_QUICK_S = 0.008  # of CPU: the event loop does nothing else meanwhile
_REMEMBERED = 0.8  # of how long a slow one took, at each quicker one of its kind
_MOST_KINDS = 1000  # all are forgotten at the next one
_this_thread = threading.local()


class NotQuick(Exception):
    """The work takes long, or needs what does, where it has to be quick."""


def quickly(work: Callable[[], T], without_queries: AbstractContextManager[None]) -> T:
    """Return what `work` returns, called in this thread, if it is quick.

    Args:
        work: Before it has all that it needs it must not change anything.
        without_queries: A block in which a query of the catalog raises `NotKept`.

    Raises:
        NotQuick: If it is not known to be, makes a query or has to load something.
    """
    _this_thread.must_be_quick = True
    try:
        with without_queries:
            found = without_loading(work)
    except NotKept:
        raise NotQuick from None
    finally:
        _this_thread.must_be_quick = False
    if isinstance(found, NotLoaded):
        raise NotQuick
    return found


def must_be_quick() -> bool:
    """Return whether this thread calls work by `quickly`."""
    return getattr(_this_thread, "must_be_quick", False)


class LastTimes:
    """How long work of each kind took last: what took some milliseconds is quick the next time.

    One that is slow is remembered for several: among those of a kind may be some that go on longer,
    as a search goes on for a heading that no scan near the query has.
    """

    def __init__(self) -> None:
        self._last_s: dict[Hashable, float] = {}

    @contextmanager
    def measured(self, kind: Hashable = None) -> Iterator[None]:
        """Measure work of a kind, in a block.

        Raises:
            NotQuick: If it has to be quick, and the last ones of its kind were not or there was
                none.
        """
        if must_be_quick() and self._last_s.get(kind, _QUICK_S) >= _QUICK_S:
            raise NotQuick
        begun_s = time.thread_time()
        yield
        took_s = time.thread_time() - begun_s
        if kind not in self._last_s and len(self._last_s) >= _MOST_KINDS:
            self._last_s.clear()
        self._last_s[kind] = max(took_s, _REMEMBERED * self._last_s.get(kind, 0.0))
