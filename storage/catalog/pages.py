"""Cursor pagination."""

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, TypeVar

from sqlalchemy import Select, tuple_
from sqlalchemy.orm import InstrumentedAttribute, Session

from core.errors import InvalidParameters
from storage.catalog.records import Page

T = TypeVar("T")

DEFAULT_LIMIT = 100

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
_CURSOR = re.compile(r"([0-9]{1,17})-([^\0]+)", re.ASCII)  # NUL: no name has it


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
    newest_first: bool = True,
) -> Page[T]:
    """Return a page of rows in the order in which they were created.

    A cursor has the time and name of a row, and stays good when that is gone.

    Args:
        session: The transaction.
        query: The rows; each has a `created_at`.
        name: The column that orders rows of the same time.
        after: The cursor of the row before the page, empty for the first page.
        limit: Number of rows in a page.
        newest_first: Whether the newest row is the first.

    Raises:
        InvalidParameters: If `after` is no cursor, or the page would be empty.
    """
    model: Any = name.class_
    columns = (model.created_at, name)
    if after:
        rows, cursor = tuple_(*columns), tuple_(*_read(after))
        query = query.where(rows < cursor if newest_first else rows > cursor)
    query = query.order_by(*(column.desc() if newest_first else column for column in columns))
    found = session.scalars(query.limit(one_more(limit))).all()
    return page_of(found, limit, lambda row: _cursor(row, getattr(row, name.key)))


def _cursor(row: Any, name: str) -> str:  # noqa: ANN401 - of any model with a `created_at`
    return f"{(row.created_at - _EPOCH) // _MICROSECOND}-{name}"


def _read(cursor: str) -> tuple[datetime, str]:
    found = _CURSOR.fullmatch(cursor)
    if found is None:
        raise InvalidParameters(
            f"the cursor {cursor[:80]!r} is not one of this list: wanted `next_after` of the page"
            " before"
        )
    return _EPOCH + int(found[1]) * _MICROSECOND, found[2]
