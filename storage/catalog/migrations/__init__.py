"""The catalog's schema, revision by revision, run when a catalog is opened."""

import threading
from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, text

from storage.errors import WrongCatalog

__all__ = ["is_newest", "upgrade"]

_LOCK = 7_665_107  # any number; only this product's migrations ask PostgreSQL for it
_ONE_AT_A_TIME = threading.Lock()  # Alembic keeps the migration that runs in a global


def is_newest(connection: Connection) -> bool:
    """Return whether the schema is the newest that this version of TensorMap knows.

    Raises:
        WrongCatalog: If a newer version made it.
    """
    found = MigrationContext.configure(connection).get_current_revision()
    known = ScriptDirectory.from_config(_config())
    if found is not None and found not in {script.revision for script in known.walk_revisions()}:
        raise WrongCatalog(
            f"the catalog's schema is {found}, this version of TensorMap knows none newer than"
            f" {known.get_current_head()}: start the version that made it"
        )
    return found == known.get_current_head()


def upgrade(connection: Connection) -> None:
    """Bring the schema to the newest revision, within the transaction of `connection`.

    Of two processes that start at once the second waits, and then finds nothing to do.
    """
    if connection.dialect.name == "postgresql":  # on SQLite the transaction itself is the lock
        connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
    config = _config()
    config.attributes["connection"] = connection
    with _ONE_AT_A_TIME:
        command.upgrade(config, "head")


def _config() -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    return config
