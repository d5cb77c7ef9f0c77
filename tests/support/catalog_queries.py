"""Queries that a store makes to its catalog."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
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


def plans(catalog: Catalog, work: Callable[[], object]) -> list[str]:
    """Return how SQLite finds the rows of each query of some work, and of its deletions."""
    made: list[tuple[str, Any]] = []
    engine = catalog._database.engine

    def collect(_connection: Any, _cursor: Any, statement: str, values: Any, *_: Any) -> None:
        if statement.startswith(("SELECT", "DELETE")):
            made.append((statement, values))

    event.listen(engine, "before_cursor_execute", collect)
    try:
        work()
    finally:
        event.remove(engine, "before_cursor_execute", collect)
    with closing(engine.raw_connection()) as connection:
        cursor = connection.cursor()
        steps = []
        for statement, values in made:
            cursor.execute(f"EXPLAIN QUERY PLAN {statement}", values)
            steps += [step for *_, step in cursor.fetchall()]
    return steps
