"""Lists of values in batches that one statement may name."""

from collections.abc import Iterator, Sequence
from typing import TypeVar

T = TypeVar("T")

_MOST = 500  # SQLite's limit of parameters is 999 or more, by its build


def batches(values: Sequence[T]) -> Iterator[Sequence[T]]:
    """Yield the values in their order, some at a time.

    Examples:
        >>> [len(some) for some in batches(range(1100))]
        [500, 500, 100]
    """
    for start in range(0, len(values), _MOST):
        yield values[start : start + _MOST]
