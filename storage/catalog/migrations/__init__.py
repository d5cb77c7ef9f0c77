"""The catalog's schema, revision by revision, run when a catalog is opened."""

import threading
from pathlib import Path

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, text

__all__ = ["upgrade"]

_LOCK = 7_665_107  # any number; only this product's migrations ask PostgreSQL for it
_ONE_AT_A_TIME = threading.Lock()  # Alembic keeps the migration that runs in a global


def upgrade(connection: Connection) -> None:
    """Bring the schema to the newest revision, within the transaction of `connection`.

    Of two processes that start at once the second waits, and then finds nothing to do.
    """
    if connection.dialect.name == "postgresql":  # on SQLite the transaction itself is the lock
        connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    with _ONE_AT_A_TIME:
        command.upgrade(config, "head")
