"""Ranges of indices: which scans of a drive are stored, which parts of a capture are missing."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

_MOST_SHOWN = 20


@dataclass(frozen=True)
class IndexRange:
    """Indices `first` to `last`, both included."""

    first: int
    last: int


def index_ranges(indices: Iterable[int]) -> tuple[IndexRange, ...]:
    """Return the ranges that indices make, in rising order.

    Examples:
        >>> [(r.first, r.last) for r in index_ranges([7, 1, 2, 2, 3])]
        [(1, 3), (7, 7)]
    """
    firsts: list[int] = []
    lasts: list[int] = []
    for index in sorted(set(indices)):
        if lasts and lasts[-1] == index - 1:
            lasts[-1] = index
        else:
            firsts.append(index)
            lasts.append(index)
    return tuple(map(IndexRange, firsts, lasts))


def ranges_text(ranges: Sequence[IndexRange]) -> str:
    """Return ranges in words, the first twenty of them.

    Examples:
        >>> ranges_text([IndexRange(0, 0), IndexRange(4, 7)])
        '0, 4 to 7'
    """
    shown = [str(r.first) if r.first == r.last else f"{r.first} to {r.last}" for r in ranges]
    more = len(shown) - _MOST_SHOWN
    return ", ".join(shown[:_MOST_SHOWN]) + (f" and {more} more" if more > 0 else "")
