"""Queries that a store makes to its catalog."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

from sqlalchemy import event

from storage.catalog import Catalog
from storage.store import Store


@contextmanager
def _each_statement(catalog: Catalog, collect: Callable[..., None]) -> Iterator[None]:
    """Call `collect(connection, cursor, statement, values, ...)` before each one of the block."""
    engine = catalog._database.engine
    event.listen(engine, "before_cursor_execute", collect)
    try:
        yield
    finally:
        event.remove(engine, "before_cursor_execute", collect)


@contextmanager
def catalog_queries(store: Store) -> Iterator[list[str]]:
    """Collect the queries of the block."""
    queries: list[str] = []

    def collect(_connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        if statement.startswith("SELECT"):
            queries.append(statement)

    with _each_statement(store.catalog, collect):
        yield queries


@contextmanager
def writers_queries(catalog: Catalog) -> Iterator[list[str]]:
    """Collect the queries that the block makes in transactions that write."""
    queries: list[str] = []

    def collect(connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        writes = "tensormap_writer" in connection.get_execution_options()
        if writes and statement.startswith("SELECT"):
            queries.append(statement)

    with _each_statement(catalog, collect):
        yield queries


def plans(catalog: Catalog, work: Callable[[], object]) -> list[str]:
    """Return how SQLite finds the rows of each query of some work, and of its deletions."""
    made: list[tuple[str, Any]] = []

    def collect(_connection: Any, _cursor: Any, statement: str, values: Any, *_: Any) -> None:
        if statement.startswith(("SELECT", "DELETE")):
            made.append((statement, values))

    with _each_statement(catalog, collect):
        work()
    with closing(catalog._database.engine.raw_connection()) as connection:
        cursor = connection.cursor()
        steps = []
        for statement, values in made:
            cursor.execute(f"EXPLAIN QUERY PLAN {statement}", values)
            steps += [step for *_, step in cursor.fetchall()]
    return steps
