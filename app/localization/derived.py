"""What is derived from objects that stay the same while nothing changed."""

import threading
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

_KEPT = 32


class Derived:
    """Results of functions, kept for the very objects that they were computed of.

    The catalog and the indexes return the same objects until something is committed: of ten
    thousand maps, going through them takes longer than finding a place in them.
    """

    def __init__(self) -> None:
        self._kept: dict[tuple[int, ...], tuple[tuple[object, ...], Any]] = {}
        self._lock = threading.Lock()

    def of(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Return the function's result for these objects, which must not be changed later.

        Args:
            function: A module's function: each access to a method is another object.
            *args: What it is computed of.
            **kwargs: The keyword arguments, which must not be changed later either.
        """
        made_of = (function, *args, *kwargs.values())
        key = tuple(map(id, made_of))  # those of objects that are kept are no others'
        found = self._kept.get(key)
        if found is None:
            found = made_of, function(*args, **kwargs)
            with self._lock:
                self._kept[key] = found
                if len(self._kept) > _KEPT:
                    del self._kept[next(iter(self._kept))]
        result: T = found[1]
        return result
