"""Cursor pagination."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from sqlalchemy import Select, tuple_
from sqlalchemy.orm import InstrumentedAttribute, Session

from core.errors import InvalidParameters
from storage.catalog.records import Page

T = TypeVar("T")

DEFAULT_LIMIT = 100


def one_more(limit: int) -> int:
    """Return the number of rows to select, so that the page shows whether it is the last.

    Raises:
        InvalidParameters: If a page would be empty.
    """
    if limit < 1:
        raise InvalidParameters(f"limit is {limit}, wanted at least 1")
    return limit + 1


def page_of(rows: Sequence[T], limit: int, cursor: Callable[[T], str]) -> Page[T]:
    """Return a page of at most `limit` of `rows`, which were selected with `one_more`."""
    items = tuple(rows[:limit])
    return Page(items, cursor(items[-1]) if len(rows) > limit else None)


def page_by_age(
    session: Session,
    query: Select[T],
    name: InstrumentedAttribute[str],
    after: str,
    limit: int,
    *,
    of_map: str | None = None,
    newest_first: bool = True,
) -> Page[T]:
    """Return a page of rows in the order in which they were created.

    Args:
        session: The transaction.
        query: The rows; each has a `created_at`.
        name: The column that is their cursor; it orders rows of the same time.
        after: The cursor of the row before the page, empty for the first page.
        limit: Number of rows in a page.
        of_map: The map whose id is the other half of the rows' primary key, if they have one.
        newest_first: Whether the newest row is the first.

    Raises:
        InvalidParameters: If `after` is no row, or the page would be empty.
    """
    model: Any = name.class_
    columns = (model.created_at, name)
    if after:
        last = session.get(model, after if of_map is None else (of_map, after))
        if last is None:
            kind = model.__name__.removesuffix("Record").lower()
            raise InvalidParameters(f"the cursor {after[:80]!r} is no {kind}")
        rows, cursor = tuple_(*columns), tuple_(last.created_at, after)
        query = query.where(rows < cursor if newest_first else rows > cursor)
    query = query.order_by(*(column.desc() if newest_first else column for column in columns))
    found = session.scalars(query.limit(one_more(limit))).all()
    return page_of(found, limit, lambda row: str(getattr(row, name.key)))
