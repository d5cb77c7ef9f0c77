"""The catalog's schema, worked out by its migrations once and repeated from then on."""

import itertools
from collections.abc import Callable
from typing import Any

from sqlalchemy import Connection, event, inspect

__all__ = ["made_once"]

_ASKING = ("SELECT", "PRAGMA")


def made_once(upgrade: Callable[[Connection], None]) -> Callable[[Connection], None]:
    """Return what brings a database to the newest schema, an empty one by what did so before.

    Hundreds of tests open a catalog of their own, and many would spend most of their time on the
    same migrations.
    """
    steps: dict[str, list[tuple[str, Any]]] = {}

    def upgrade_or_repeat(connection: Connection) -> None:
        dialect = connection.dialect.name
        if inspect(connection).get_table_names():
            upgrade(connection)
        elif dialect in steps:
            for statement, parameters in steps[dialect]:
                connection.exec_driver_sql(statement, parameters or None)
        else:
            steps[dialect] = _steps_of(upgrade, connection)
            if dialect == "postgresql":  # whose driver takes several at once
                steps[dialect] = _at_once(steps[dialect])

    return upgrade_or_repeat


def _steps_of(
    upgrade: Callable[[Connection], None], connection: Connection
) -> list[tuple[str, Any]]:
    """Upgrade, and return every statement that changed something."""
    steps: list[tuple[str, Any]] = []

    def note(_connection: Any, _cursor: Any, statement: str, parameters: Any, *_: Any) -> None:
        if not statement.startswith(_ASKING):
            steps.append((statement, parameters))

    event.listen(connection, "before_cursor_execute", note)
    upgrade(connection)
    event.remove(connection, "before_cursor_execute", note)
    return steps


def _at_once(steps: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
    """Return fewer steps that do the same: those without parameters that follow one another."""
    joined: list[tuple[str, Any]] = []
    for with_parameters, several in itertools.groupby(steps, key=lambda step: bool(step[1])):
        if with_parameters:
            joined += several
        else:
            joined.append((";\n".join(statement for statement, _ in several), None))
    return joined
