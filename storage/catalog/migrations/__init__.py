"""The catalog's schema, revision by revision, run when a catalog is opened.

Alembic is imported where it works: it takes as long as SQLAlchemy itself, and a catalog whose
schema is the newest does without.
"""

import threading
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy import Connection, inspect, text

from storage.catalog.models import Base
from storage.errors import WrongCatalog

if TYPE_CHECKING:
    from alembic.config import Config

__all__ = ["Schema", "alembic_config", "schema_of", "upgrade"]

_FOLDER = Path(__file__).parent
_LOCK = 7_665_107  # any number; only this product's migrations ask PostgreSQL for it
_ONE_AT_A_TIME = threading.Lock()  # Alembic keeps the migration that runs in a global


class Schema(Enum):
    """The schema in a database."""

    NONE = "none"
    OLDER = "older"
    NEWEST = "newest"


def schema_of(connection: Connection) -> Schema:
    """Return which schema a database has: none, one of an older version, or the newest one.

    Raises:
        WrongCatalog: If a newer version made it, or another program.
    """
    tables = inspect(connection)
    if not tables.has_table("alembic_version"):
        # On PostgreSQL others, as those of an extension, may be beside ours, but not of one name.
        shared = connection.dialect.name == "postgresql"
        others = set(tables.get_table_names())
        if shared:
            others &= Base.metadata.tables.keys()
        if others:
            raise WrongCatalog(
                f"{connection.engine.url.database} is no catalog of TensorMap: another program made"
                f" its table {min(others)!r}; wanted a catalog or an empty database"
            )
        return Schema.NONE
    found = connection.execute(text("SELECT version_num FROM alembic_version")).scalar()
    # A file is named by its revision, and they are in order, as
    # tests/unit/storage/catalog/test_migrations.py checks.
    known = sorted(path.name.partition("_")[0] for path in _FOLDER.glob("versions/[0-9]*.py"))
    if found is not None and found not in known:
        raise WrongCatalog(
            f"the catalog's schema is {found}, this version of TensorMap knows none newer than"
            f" {known[-1]}: start the version that made it"
        )
    return Schema.NEWEST if found == known[-1] else Schema.OLDER


def upgrade(connection: Connection) -> None:
    """Bring the schema to the newest revision, within the transaction of `connection`.

    Of two processes that start at once the second waits, and then finds nothing to do.
    """
    from alembic import command

    if connection.dialect.name == "postgresql":  # on SQLite the transaction itself is the lock
        connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
    config = alembic_config()
    config.attributes["connection"] = connection
    with _ONE_AT_A_TIME:
        command.upgrade(config, "head")


def alembic_config() -> "Config":
    """Return what Alembic's commands want to know; they run on `attributes["connection"]`."""
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(_FOLDER).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    return config
