"""Values that take long to load: one thread loads each, and short work does not wait for it."""

import threading
from collections.abc import Callable, Hashable
from functools import partial
from typing import Generic, TypeVar
from weakref import WeakValueDictionary

K = TypeVar("K", bound=Hashable)
T = TypeVar("T")
V = TypeVar("V")

_this_thread = threading.local()


class NotLoaded(Exception):
    """A value would have to be loaded, within work that must not wait for that.

    Attributes:
        name: Equal for all work that needs the same value.
        load: Loads it, and returns it.
    """

    def __init__(self, name: Hashable, load: Callable[[], object]) -> None:
        super().__init__(name)
        self.name, self.load = name, load


def without_loading(work: Callable[[], T]) -> T | NotLoaded:
    """Return what `work` returns, called in this thread, or what it needs that is not loaded."""
    _this_thread.must_not_load = True
    try:
        return work()
    except NotLoaded as needed:
        # An exception that a thread raises is in a cycle with its frames, and so would be `load`.
        return needed.with_traceback(None)
    finally:
        _this_thread.must_not_load = False


class Loading(Generic[K, V]):
    """Loads values by key, each in one thread while others that need the same one wait.

    Args:
        kept: Returns the value of a key if it is loaded, else `None`.
    """

    def __init__(self, kept: Callable[[K], V | None]) -> None:
        self._kept = kept
        self._guard = threading.Lock()
        # A lock exists while a thread holds it or waits for it.
        self._locks: WeakValueDictionary[K, threading.Lock] = WeakValueDictionary()

    def get(self, key: K, load: Callable[[], V]) -> V:
        """Return the value of a key.

        Args:
            key: The value's key.
            load: Loads it, and keeps it.

        Raises:
            NotLoaded: If it is not loaded, and this thread must not wait.
        """
        found = self._kept(key)
        if found is not None:
            return found
        if getattr(_this_thread, "must_not_load", False):
            raise NotLoaded((id(self), key), partial(self.get, key, load))
        with self._guard:
            lock = self._locks.setdefault(key, threading.Lock())
        with lock:
            found = self._kept(key)
            return load() if found is None else found
