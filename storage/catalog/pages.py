"""Cursor pagination: a page, and where the next one begins."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from core.errors import InvalidParameters
from storage.catalog.records import Page

__all__ = ["DEFAULT_LIMIT", "one_more", "page_of"]

T = TypeVar("T")

DEFAULT_LIMIT = 100


def one_more(limit: int) -> int:
    """Return how many rows to ask for, so that the page knows whether it is the last.

    Raises:
        InvalidParameters: If a page would be empty.
    """
    if limit < 1:
        raise InvalidParameters(f"limit is {limit}, wanted at least 1")
    return limit + 1


def page_of(rows: Sequence[T], limit: int, cursor: Callable[[T], str]) -> Page[T]:
    """Make a page of at most `limit` of `rows`, which were asked for with `one_more`."""
    items = tuple(rows[:limit])
    return Page(items, cursor(items[-1]) if len(rows) > limit else None)
