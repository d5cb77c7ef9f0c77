"""Cursor pagination."""

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta
from typing import Any, TypeVar

from sqlalchemy import Select, tuple_
from sqlalchemy.orm import InstrumentedAttribute, Session

from core.errors import InvalidParameters
from storage.catalog.records import Page

T = TypeVar("T")

DEFAULT_LIMIT = 100
PAGE_CHARACTERS = 4 * 2**20
"""A page ends before a row with which its texts and lists would be longer; it has one at least."""

ROWS_AT_ONCE = 20  # a capture's row has up to 280 kB, and takes twice that in memory

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


def page_of(
    rows: Iterable[T],
    limit: int,
    cursor: Callable[[T], str],
    characters: Callable[[T], int] = lambda _: 0,
) -> Page[T]:
    """Return a page of at most `limit` of `rows`, which were selected with `one_more`.

    Args:
        rows: The rows; no more of them are taken than it needs.
        limit: Maximum number of rows in the page.
        cursor: Returns the cursor of a row.
        characters: Returns the length of what has no bound in a row: the page ends before one with
            which it would have more than `PAGE_CHARACTERS`.
    """
    found: list[T] = []
    taken = 0
    for row in rows:
        taken += characters(row)
        if found and (len(found) == limit or taken > PAGE_CHARACTERS):
            return Page(tuple(found), cursor(found[-1]))
        found.append(row)
    return Page(tuple(found), None)


def all_items(read: Callable[[str], Page[T]]) -> Iterator[T]:
    """Yield the items of a list, page by page; `read` returns the page after a cursor."""
    after: str | None = ""
    while after is not None:
        page = read(after)
        yield from page.items
        after = page.next_after


def page_by_age(
    session: Session,
    query: Select[T],
    name: InstrumentedAttribute[str],
    after: str,
    limit: int,
    *,
    newest_first: bool = True,
    numbered: bool = False,
) -> Page[T]:
    """Return a page of rows in the order in which they were created.

    It ends early where its rows are large: 1,000 of them may have 280 MB. A cursor has the time or
    number of a row and its name, and stays good when that is gone.

    Args:
        session: The transaction.
        query: The rows; each has a `created_at`.
        name: The column that orders rows of the same time or number.
        after: The cursor of the row before the page, empty for the first page.
        limit: Maximum number of rows in a page.
        newest_first: Whether the newest row is the first.
        numbered: Whether their order is that of their `number`, and not of `created_at`.

    Raises:
        InvalidParameters: If `after` is no cursor, or the page would be empty.
    """
    model: Any = name.class_
    columns = (model.number if numbered else model.created_at, name)
    if after:
        number, of_row = _read(after)
        at: Any = number if numbered else _EPOCH + number * _MICROSECOND
        rows, cursor = tuple_(*columns), tuple_(at, of_row)
        query = query.where(rows < cursor if newest_first else rows > cursor)
    query = query.order_by(*(column.desc() if newest_first else column for column in columns))
    query = query.limit(one_more(limit)).execution_options(yield_per=ROWS_AT_ONCE)

    def cursor_of(row: Any) -> str:  # noqa: ANN401 - of any model with a `created_at`
        number = row.number if numbered else (row.created_at - _EPOCH) // _MICROSECOND
        return f"{number}-{getattr(row, name.key)}"

    with closing(session.scalars(query)) as found:
        return page_of(found, limit, cursor_of, _characters)


def _characters(row: object) -> int:
    """Return the length of what has no bound of its own in a row: texts, lists and mappings."""
    values = vars(row).values()
    return sum(len(str(value)) for value in values if isinstance(value, str | list | dict))


def _read(cursor: str) -> tuple[int, str]:
    found = _CURSOR.fullmatch(cursor)
    if found is None:
        raise InvalidParameters(
            f"the cursor {cursor[:80]!r} is not one of this list: wanted `next_after` of the page"
            " before"
        )
    return int(found[1]), found[2]
