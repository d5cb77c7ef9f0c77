"""Queries that a store makes to its catalog."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy import event

from storage.catalog import Catalog
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


@contextmanager
def writers_queries(catalog: Catalog) -> Iterator[list[str]]:
    """Collect the queries that the block makes in transactions that write."""
    queries: list[str] = []
    engine = catalog._database.engine

    def collect(connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        if statement.startswith("SELECT") and "tensormap_writer" in (
            connection.get_execution_options()
        ):
            queries.append(statement)

    event.listen(engine, "before_cursor_execute", collect)
    try:
        yield queries
    finally:
        event.remove(engine, "before_cursor_execute", collect)
