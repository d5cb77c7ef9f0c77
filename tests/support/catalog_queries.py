"""Queries that a store makes to its catalog."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy import event

from storage.store import Store


@contextmanager
def catalog_queries(store: Store) -> Iterator[list[str]]:
    """Collect the queries of the block."""
    queries: list[str] = []
    engine = store.catalog._database.engine

    def collect(_connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        if statement.startswith("SELECT"):
            queries.append(statement)

    event.listen(engine, "before_cursor_execute", collect)
    try:
        yield queries
    finally:
        event.remove(engine, "before_cursor_execute", collect)
