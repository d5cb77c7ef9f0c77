"""The copy of a catalog in a backup."""

import sqlite3
from contextlib import closing

import pytest

from storage.backup import catalog_copy
from storage.backup.backup import write_backup
from storage.errors import CorruptFile, StorageFull, StorageUnavailable

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        (sqlite3.SQLITE_FULL, StorageFull),
        (sqlite3.SQLITE_IOERR_READ, StorageUnavailable),
        (sqlite3.SQLITE_CANTOPEN, StorageUnavailable),
        (sqlite3.SQLITE_CORRUPT_INDEX, CorruptFile),
    ],
)
def test_a_catalog_is_damaged_only_where_sqlite_finds_damage(
    filled, tmp_path, monkeypatch, code, kind
):
    class Failing(sqlite3.Connection):
        def execute(self, *words):
            error = sqlite3.OperationalError("so")
            error.sqlite_errorcode = code
            raise error

    connect = sqlite3.connect

    def connect_failing(database, **options):
        if "immutable" in str(database):  # the copy, to be read
            options["factory"] = Failing
        return connect(database, **options)

    monkeypatch.setattr(sqlite3, "connect", connect_failing)
    with pytest.raises(kind) as raised:
        write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert type(raised.value) is kind
    assert not list(tmp_path.glob("*.tar*"))


def test_the_scans_of_a_catalog_are_listed_without_a_temporary_file(filled):
    with closing(sqlite3.connect(filled.layout.catalog)) as connection:
        plan = connection.execute(f"EXPLAIN QUERY PLAN {catalog_copy._SCANS}").fetchall()
    assert plan
    assert not [step for *_, step in plan if "TEMP B-TREE" in step]
