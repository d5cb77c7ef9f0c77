"""What is derived from objects that stay the same while nothing changed."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, TypeVar, TypeVarTuple

from storage.catalog.map_summaries import MOST_LIMITS

Ts = TypeVarTuple("Ts")
T = TypeVar("T")

_KEPT = 4 * MOST_LIMITS  # results: a query of a key's maps uses up to four


class Derived:
    """Results of functions, kept for the very objects that they were computed of.

    The catalog and the indexes return the same objects until something is committed: of ten
    thousand maps, going through them takes longer than finding a place in them. What was not used
    for the longest time is dropped first.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[int, ...], tuple[tuple[object, ...], Any]] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, function: Callable[[*Ts], T], *args: *Ts) -> T:
        """Return the function's result for these objects, which must not be changed later.

        Args:
            function: A module's function: each access to a method is another object.
            *args: What it is computed of.
        """
        made_of: tuple[object, ...] = (function, *args)
        key = tuple(map(id, made_of))  # those of objects that are kept are no others'
        with self._lock:
            found = self._kept.get(key)
            if found is not None:
                self._kept.move_to_end(key)
        if found is None:
            found = made_of, function(*args)
            with self._lock:
                self._kept[key] = found
                if len(self._kept) > _KEPT:
                    self._kept.popitem(last=False)
        result: T = found[1]
        return result
