"""Limits of SQLite, which differ by its build."""

import sqlite3

from sqlalchemy import event

from storage.catalog import Catalog


def allow_999_variables(catalog: Catalog) -> None:
    """Limit its statements as some builds of SQLite do; what ours allows depends on who built it.

    Nothing is limited on another database.
    """

    def limit(connection: object, *_: object) -> None:
        if isinstance(connection, sqlite3.Connection):
            connection.setlimit(sqlite3.SQLITE_LIMIT_VARIABLE_NUMBER, 999)

    event.listen(catalog._database.engine, "checkout", limit)
