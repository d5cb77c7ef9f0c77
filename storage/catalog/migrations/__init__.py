"""The catalog's schema: made at once in an empty database, or brought from an older revision.

Alembic is imported where it works: it takes as long as SQLAlchemy itself, and a catalog that is
new, or whose schema is the newest, does without.
"""

import logging
import threading
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy import Connection, insert, inspect, text

from storage.catalog.models import AuditHead, Base
from storage.errors import WrongCatalog

if TYPE_CHECKING:
    from alembic.config import Config

__all__ = ["Schema", "alembic_config", "schema_of", "upgrade"]

_FOLDER = Path(__file__).parent
_LOCK = 7_665_107  # any number; only this product's migrations ask PostgreSQL for it
_log = logging.getLogger("tensormap.storage")
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
    found = _version(connection)
    known = _revisions()
    if found is not None and found not in known:
        raise WrongCatalog(
            f"the catalog's schema is {found}, this version of TensorMap knows none newer than"
            f" {known[-1]}: start the version that made it"
        )
    return Schema.NEWEST if found == known[-1] else Schema.OLDER


def upgrade(connection: Connection) -> None:
    """Make the newest schema, or bring that of an older version to it.

    Within the transaction of `connection`: of two processes that start at once the second waits,
    and then finds nothing to do.
    """
    if connection.dialect.name == "postgresql":  # on SQLite the transaction itself is the lock
        connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
    if schema_of(connection) is Schema.NONE:
        _create(connection)
        return
    from alembic import command

    config = alembic_config()
    config.attributes["connection"] = connection
    before = _version(connection)
    with _ONE_AT_A_TIME:
        command.upgrade(config, "head")
    if before != (after := _version(connection)):
        _log.info("the catalog's schema was %s and is %s now", before, after)


def _create(connection: Connection) -> None:
    """Make the tables of the models, which are what all migrations make of an empty database."""
    Base.metadata.create_all(connection)
    connection.execute(insert(AuditHead).values(row=1, seq=0, hash="0" * 64))
    connection.execute(
        text(
            "CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL,"
            " CONSTRAINT alembic_version_pkc PRIMARY KEY (version_num))"
        )
    )
    connection.execute(
        text("INSERT INTO alembic_version VALUES (:newest)"), {"newest": _revisions()[-1]}
    )


def _version(connection: Connection) -> str | None:
    found = connection.execute(text("SELECT version_num FROM alembic_version")).scalar()
    return None if found is None else str(found)


def _revisions() -> list[str]:
    """Return the revisions of the schema, the newest last.

    A file is named by its revision, and they are in order, as
    tests/unit/storage/catalog/test_migrations.py checks.
    """
    return sorted(path.name.partition("_")[0] for path in _FOLDER.glob("versions/[0-9]*.py"))


def alembic_config() -> "Config":
    """Return what Alembic's commands want to know; they run on `attributes["connection"]`."""
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(_FOLDER).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    return config
