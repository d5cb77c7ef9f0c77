"""A file whose rows may have been committed is kept, on each database."""

import sqlite3
import threading
from contextlib import contextmanager

import pytest

from storage.catalog import NewCapture, RevisionFacts
from storage.errors import StorageBusy, StorageUnavailable
from storage.store import Store
from tests.support.catalog_rows import A
from tests.support.map_files import revision_file
from tests.support.samples import sample_harmonic_map
from tests.support.small_scans import sample_scan

FACTS = RevisionFacts(encoding="paper", scans=10, segments=2, parameters={})
PART = b"a part of a bag"


@pytest.fixture
def store(tmp_path, database_url):
    with Store(tmp_path / "data", database_url) as opened:
        opened.maps.create("campus")
        opened.drives.put_scan("campus", "tuesday", 0, sample_scan(0))
        opened.drives.put_scan("campus", "tuesday", 1, sample_scan(1))
        new = NewCapture("monday", (("a.bag", len(PART)),), len(PART))
        opened.captures.create("campus", new)
        yield opened


class Scan:
    """A scan that is put."""

    commits = 1

    @staticmethod
    def act(store):
        store.drives.put_scan("campus", "monday", 7, sample_scan(7))

    @staticmethod
    def check(store):
        stored = store.drives.read_scan("campus", "monday", 7)
        assert stored.points_m.tobytes() == sample_scan(7).points_m.tobytes()


class PackedScans:
    """Scans that are packed into one file: the second commit of a closing."""

    commits = 2

    @staticmethod
    def act(store):
        store.drives.close("campus", "tuesday")

    @staticmethod
    def check(store):
        for index in range(2):
            stored = store.drives.read_scan("campus", "tuesday", index)
            assert stored.points_m.tobytes() == sample_scan(index).points_m.tobytes()


class Revision:
    """A revision that becomes live."""

    commits = 1

    @staticmethod
    def act(store):
        campus = store.maps.get("campus").id
        store.revisions.add(campus, A, lambda path: path.write_bytes(b"a map"), FACTS)

    @staticmethod
    def check(store):
        live = store.revisions.live("campus").digest
        assert revision_file(store, "campus", live).read_bytes() == b"a map"


class Basis:
    """A shared basis."""

    commits = 1
    basis = sample_harmonic_map(20)[0].basis()

    @classmethod
    def act(cls, store):
        store.bases.add("city", cls.basis)

    @classmethod
    def check(cls, store):
        assert store.bases.read("city").digest == cls.basis.digest


class Part:
    """A part of a capture."""

    commits = 1

    @staticmethod
    def act(store):
        (capture,) = store.captures.list("campus").items
        store.captures.put_part("campus", "monday", capture.id, 0, PART)

    @staticmethod
    def check(store):
        (capture,) = store.captures.list("campus").items
        ((_, name),) = store.catalog.captures.parts(capture.id).values()
        path = store.layout.capture(capture.map_id, capture.id) / name
        assert path.read_bytes() == PART


WRITES = [Scan, PackedScans, Revision, Basis, Part]


def files(store):
    folders = (store.layout.maps, store.layout.bases)
    return sorted(path for folder in folders for path in folder.rglob("*") if path.is_file())


@contextmanager
def failing_commit(store, monkeypatch, number, *, committed):
    """Let the COMMIT of that number fail: after it took effect, or by the database's refusal."""
    dialect = store.catalog._database.engine.dialect
    do_commit = dialect.do_commit
    numbers = iter(range(1, 100))
    writer = threading.get_ident()

    def fail(connection):
        # Catalogs of one test process share a dialect: services of other tests commit, too.
        if threading.get_ident() != writer or next(numbers) != number:
            do_commit(connection)
        elif committed:
            do_commit(connection)
            raise dialect.loaded_dbapi.OperationalError("server closed the connection")
        else:
            refused = dialect.loaded_dbapi.OperationalError("another transaction was first")
            if dialect.name == "sqlite":
                refused.sqlite_errorcode = sqlite3.SQLITE_BUSY
            else:
                refused.sqlstate = "40001"
            raise refused

    with monkeypatch.context() as patch:
        patch.setattr(dialect, "do_commit", fail)
        yield


@pytest.mark.parametrize("write", WRITES, ids=lambda write: write.__name__)
class TestAWriteWhoseCommitFails:
    def test_has_its_file_if_the_commit_took_effect(self, store, monkeypatch, write):
        with (
            failing_commit(store, monkeypatch, write.commits, committed=True),
            pytest.raises(StorageUnavailable),
        ):
            write.act(store)
        write.check(store)
        store.recover()
        write.check(store)

    def test_leaves_no_file_if_the_database_refused_it(self, store, monkeypatch, write):
        before = files(store)
        with (
            failing_commit(store, monkeypatch, write.commits, committed=False),
            pytest.raises(StorageBusy),
        ):
            write.act(store)
        assert files(store) == before
        write.act(store)
        write.check(store)
