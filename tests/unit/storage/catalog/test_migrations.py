"""The migrations and the models are one schema."""

import logging
import sqlite3
import subprocess
import sys
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import MetaData, create_engine, inspect

from storage.catalog import Catalog, migrations
from storage.catalog.models import Base
from storage.errors import StorageReadOnly, StorageUnavailable, WrongCatalog, with_cause


def migrated(url, revision="head"):
    """Run the migrations up to one on an empty database."""
    engine = create_engine(url)
    with engine.begin() as connection:
        config = migrations.alembic_config()
        config.attributes["connection"] = connection
        command.upgrade(config, revision)
    return engine


def content_of(engine):
    """Return all that a database consists of, whatever the order of its columns is."""
    found, tables = inspect(engine), MetaData()
    tables.reflect(engine)
    defaults = {
        (table, column["name"]): str(column["default"]).partition("::")[0]
        for table in tables.tables
        for column in found.get_columns(table)
    }
    with engine.connect() as connection:
        return {
            table.name: (
                {
                    column.name: (
                        column.type.compile(engine.dialect),
                        column.nullable,
                        defaults[table.name, column.name],
                    )
                    for column in table.columns
                },
                found.get_pk_constraint(table.name),
                sorted(found.get_foreign_keys(table.name), key=lambda key: key["name"]),
                sorted(found.get_unique_constraints(table.name), key=lambda key: key["name"]),
                sorted(found.get_indexes(table.name), key=lambda index: index["name"]),
                [row._asdict() for row in connection.execute(table.select())],
            )
            for table in tables.sorted_tables
        }


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_new_catalog_is_what_all_migrations_make_of_an_empty_database(
    tmp_path, new_database, kind
):
    url = new_database(kind)
    Catalog(url).close()
    engine = create_engine(url)
    new = content_of(engine)
    engine.dispose()
    (tmp_path / "catalog.sqlite3").unlink(missing_ok=True)
    engine = migrated(new_database(kind))
    assert new == content_of(engine)
    assert {"maps", "jobs", "audit_head", "alembic_version"} < new.keys()
    engine.dispose()


def test_the_migrations_make_the_schema_of_the_models(tmp_path):
    engine = migrated(f"sqlite:///{tmp_path / 'catalog.sqlite3'}")
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_server_default": True})
        assert compare_metadata(context, Base.metadata) == []
    engine.dispose()


def test_a_new_catalog_is_made_without_alembic(tmp_path):
    made = (
        "import sys; from storage.catalog import Catalog;"
        f" Catalog('sqlite:///{tmp_path / 'catalog.sqlite3'}').close();"
        " print('alembic' in sys.modules)"
    )
    ended = subprocess.run([sys.executable, "-c", made], capture_output=True, text=True, check=True)
    assert ended.stdout == "False\n"


def test_a_migration_is_in_a_file_named_by_its_revision_and_they_are_in_order():
    chain = ScriptDirectory.from_config(migrations.alembic_config()).walk_revisions()
    revisions = [script.revision for script in chain][::-1]
    assert revisions == sorted(revisions)
    files = sorted((Path(migrations.__file__).parent / "versions").glob("*.py"))
    assert [file.name.partition("_")[0] for file in files] == revisions


def test_opening_leaves_logging_alone_and_the_database_durable(tmp_path):
    root = logging.getLogger()
    before = (root.level, list(root.handlers), logging.getLogger("alembic").level)
    catalog = Catalog(f"sqlite:///{tmp_path / 'catalog.sqlite3'}")
    assert before == (root.level, list(root.handlers), logging.getLogger("alembic").level)
    with catalog._database.engine.connect() as connection:
        settings = {
            name: connection.exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in ("journal_mode", "synchronous", "foreign_keys", "busy_timeout")
        }
    assert settings == {
        "journal_mode": "wal",
        "synchronous": 2,
        "foreign_keys": 1,
        "busy_timeout": 30_000,
    }
    catalog.close()


def test_a_migration_that_fails_leaves_the_database_as_it_was(tmp_path):
    path = tmp_path / "catalog.sqlite3"
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE alembic_version (version_num TEXT)")
        connection.execute("CREATE TABLE jobs (other TEXT)")
    connection.close()
    with pytest.raises(StorageUnavailable) as failed:
        Catalog(f"sqlite:///{path}")
    assert "jobs" in with_cause(failed.value)
    with closing(sqlite3.connect(path)) as connection, connection:
        tables = [name for (name,) in connection.execute("SELECT name FROM sqlite_master")]
    connection.close()
    assert tables == ["alembic_version", "jobs"]


def test_tables_of_another_program_are_taken_for_none_of_a_catalog(database_url):
    engine = create_engine(database_url)
    with engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE jobs (other TEXT)")
    with pytest.raises(WrongCatalog, match="another program made its table 'jobs'"):
        Catalog(database_url)
    with engine.begin() as connection:
        assert inspect(connection).get_table_names() == ["jobs"]
    engine.dispose()


def test_a_catalog_that_cannot_be_opened_raises_a_named_error(tmp_path):
    with pytest.raises(StorageReadOnly) as failed:
        Catalog(f"sqlite:///{tmp_path / 'nowhere' / 'catalog.sqlite3'}")
    assert "unable to open" in with_cause(failed.value)


def test_a_key_of_the_first_release_still_opens(tmp_path):
    url = f"sqlite:///{tmp_path / 'catalog.sqlite3'}"
    engine = migrated(url, "0002")
    with engine.begin() as connection:
        connection.exec_driver_sql(
            "INSERT INTO keys VALUES ('ab12', 'hash', '[\"admin\"]', '2026-01-01 00:00:00', NULL)"
        )
    engine.dispose()
    catalog = Catalog(url)
    key = catalog.keys.with_hash("hash")
    catalog.close()
    assert key is not None
    assert (key.id, key.scopes, key.maps, key.first_run) == ("ab12", ["admin"], None, True)
    assert key.opens_at(datetime.now(UTC))
