"""The catalog's schema, made by its migrations once and copied from then on."""

import sqlite3
from collections.abc import Callable
from typing import cast

from sqlalchemy import Connection, inspect

__all__ = ["made_once"]


def made_once(upgrade: Callable[[Connection], None]) -> Callable[[Connection], None]:
    """Return what brings a database to the newest schema, an empty one on SQLite by copying.

    Hundreds of tests open a catalog of their own, and many would spend most of their time on the
    same migrations. What is copied is what they made, statement by statement.
    """
    statements: list[str] = []

    def upgrade_or_copy(connection: Connection) -> None:
        if connection.dialect.name != "sqlite" or inspect(connection).get_table_names():
            upgrade(connection)
        elif statements:
            for statement in statements:
                connection.exec_driver_sql(statement)
        else:
            upgrade(connection)
            driver = cast("sqlite3.Connection", connection.connection.driver_connection)
            dumped = driver.iterdump()
            statements.extend(s for s in dumped if s not in {"BEGIN TRANSACTION;", "COMMIT;"})

    return upgrade_or_copy
