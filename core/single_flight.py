"""Values, each computed by one thread while others wait for it."""

import threading
from collections.abc import Callable, Hashable
from functools import cached_property, lru_cache
from typing import Any, Generic, Self, TypeVar, overload
from weakref import WeakMethod

T = TypeVar("T")


class SingleFlight(Generic[T]):
    """A function whose values of the last arguments are kept.

    As `functools.lru_cache`, which computes a value once in each thread that needs it meanwhile.

    Args:
        compute: The function.
        kept: For how many arguments values are kept.

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
        value = self._value(arguments)
        with value.lock:
            if not value.computed:
                value.computed.append(self._compute(*arguments))
        return value.computed[0]

    def known(self, *arguments: Hashable) -> T | None:
        """Return the value of some arguments if it is kept, without waiting for it."""
        computed = self._value(arguments).computed
        return computed[0] if computed else None

    def _value(self, arguments: tuple[Hashable, ...]) -> "_Value[T]":
        with self._lock:
            return self._values(*arguments)


def weakly(method: Callable[..., T]) -> Callable[..., T]:
    """Return a method that does not keep its object, for a `SingleFlight` that the object keeps.

    What refers to itself stays in memory until objects of its kind are searched for. A service does
    that seldom (`app.process.collect_seldom`), and maps are large.

    Args:
        method: A method of an object that exists whenever the result is called.
    """
    reference = WeakMethod(method)

    def call(*arguments: Hashable) -> T:
        found = reference()
        assert found is not None  # noqa: S101 - for mypy
        return found(*arguments)

    return call


class _Value(Generic[T]):
    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.computed: list[T] = []  # one, or none yet


class single_flight_property(cached_property[T]):  # noqa: N801 - as `cached_property`
    """As `cached_property`, which has no lock since Python 3.12, and before one for all objects."""

    @overload
    def __get__(self, instance: None, owner: type[Any] | None = None) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type[Any] | None = None) -> T: ...
    def __get__(self, instance: object | None, owner: type[Any] | None = None) -> Self | T:
        if instance is None:
            return self
        kept, name = vars(instance), str(self.attrname)
        lock = f"lock of {name}"
        with kept.setdefault(lock, threading.RLock()):
            if name not in kept:
                kept[name] = self.func(instance)
        kept.pop(lock, None)  # who makes another one finds the value
        value: T = kept[name]
        return value
