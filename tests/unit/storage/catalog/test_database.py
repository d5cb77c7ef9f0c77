"""A database that fails is raised by name."""

import shutil
import sqlite3
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from types import SimpleNamespace

import pytest
from sqlalchemy.exc import (
    DatabaseError,
    IntegrityError,
    InterfaceError,
    OperationalError,
    PendingRollbackError,
)
from sqlalchemy.exc import (
    TimeoutError as PoolTimeoutError,
)

from storage.catalog import Catalog, database
from storage.catalog.database import _engine
from storage.errors import (
    StorageBusy,
    StorageError,
    StorageFull,
    StorageReadOnly,
    StorageUnavailable,
    with_cause,
)
from storage.store import Store

FAULTS = [
    OperationalError("SELECT 1", {}, sqlite3.OperationalError("disk I/O error")),
    OperationalError("SELECT 1", {}, ConnectionError("server closed the connection")),
    DatabaseError("SELECT 1", {}, sqlite3.DatabaseError("malformed")),
    InterfaceError("SELECT 1", {}, Exception("connection already closed")),
    PoolTimeoutError("QueuePool limit of size 16 overflow 32 reached"),
    PendingRollbackError("the connection is gone"),
    sqlite3.OperationalError("disk I/O error"),
]


@pytest.mark.parametrize("scheme", ["postgresql", "postgresql+psycopg"])
def test_no_query_waits_for_good_where_the_network_drops_packets(scheme):
    pytest.importorskip("psycopg")
    found = _engine(f"{scheme}://maps@10.0.0.9/maps?connect_timeout=3&sslmode=require")
    _, options = found.dialect.create_connect_args(found.url)
    assert (options["connect_timeout"], options["sslmode"]) == ("3", "require")  # as it was given
    probed_s = int(options["keepalives_idle"]) + int(options["keepalives_interval"]) * int(
        options["keepalives_count"]
    )
    assert probed_s == 30
    assert int(options["tcp_user_timeout"]) == 30_000


def test_a_writer_waits_for_a_long_change_of_its_own_process(store, monkeypatch):
    monkeypatch.setattr(database, "_BUSY_TIMEOUT_S", 0.05)
    with ThreadPoolExecutor(1) as pool:
        with store.catalog._database.writing():
            waiting = pool.submit(store.maps.create, "north")
            with pytest.raises(TimeoutError):
                waiting.result(timeout=0.3)
        assert waiting.result(timeout=60).slug == "north"


class HeldElsewhere:
    """A connection to a database that another process holds, and what happens meanwhile."""

    def __init__(self, clock, meanwhile=lambda: None):
        self.allowed_ms: list[int] = []
        self._clock, self._meanwhile = clock, meanwhile
        self.connection = SimpleNamespace(cursor=lambda: SimpleNamespace(execute=self._pragma))

    def _pragma(self, statement):
        self.allowed_ms.append(int(statement.removeprefix("PRAGMA busy_timeout = ")))

    def exec_driver_sql(self, statement):
        assert statement == "BEGIN IMMEDIATE"
        ends_s = self._clock[0] + self.allowed_ms[-1] / 1000
        self._meanwhile()
        self._clock[0] = ends_s
        raise OperationalError(statement, {}, sqlite3.OperationalError("database is locked"))


@pytest.mark.parametrize("later_s", [0, 12])
def test_what_another_process_takes_counts_for_all_who_wait_meanwhile(monkeypatch, later_s):
    clock, queued = [100.0], threading.Event()
    monkeypatch.setattr(database, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    writer = database._OneWriter()
    lock = writer._lock

    def write(connection):
        with writer:
            writer.begin(connection)

    def acquire():
        queued.set()
        return lock.acquire()

    monkeypatch.setattr(writer, "_lock", SimpleNamespace(acquire=acquire, release=lock.release))
    second = HeldElsewhere(clock)
    with ThreadPoolExecutor(1) as pool:
        others: list[Future[None]] = []

        def another_comes():
            clock[0] += later_s
            queued.clear()
            others.append(pool.submit(write, second))
            assert queued.wait(60)

        first = HeldElsewhere(clock, another_comes)
        with pytest.raises(OperationalError):
            write(first)
        with pytest.raises(OperationalError):
            others[0].result(timeout=60)
    third = HeldElsewhere(clock)  # it comes when nobody waits any more
    with pytest.raises(OperationalError):
        write(third)
    assert first.allowed_ms == third.allowed_ms == [30_000, 30_000]
    assert second.allowed_ms == [later_s * 1000, 30_000]


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: type(fault).__name__)
@pytest.mark.parametrize("side", ["reading", "writing"])
def test_every_error_of_the_database_has_a_name(store, fault, side):
    with pytest.raises(StorageUnavailable) as named, getattr(store.catalog._database, side)():
        raise fault
    assert named.value.__cause__ is fault
    text = str(getattr(fault, "orig", None) or fault)
    assert text not in str(named.value)
    assert text in with_cause(named.value)


def test_a_conflict_of_two_writers_is_raised_to_the_caller(store):
    conflict = IntegrityError("INSERT", {}, Exception("unique"))
    with pytest.raises(IntegrityError), store.catalog._database.writing():
        raise conflict


def test_a_database_that_is_damaged_while_it_is_open_raises_a_named_error(tmp_path, store):
    for number in range(300):
        store.maps.create(f"map-{number}")
    data_dir = store.layout.data_dir
    store.close()  # all is in the one file now
    shutil.copytree(data_dir, tmp_path / "copy")
    with Store(tmp_path / "copy") as opened:
        path = opened.layout.catalog
        whole = path.read_bytes()
        # Past the header and the schema, which the open connection has read already.
        path.write_bytes(whole[:8192] + b"\xa5" * (len(whole) - 8192))
        opened.catalog._database.engine.dispose()
        with pytest.raises(StorageUnavailable):
            opened.maps.list(limit=1000)
        with pytest.raises(StorageUnavailable):
            opened.jobs.claim()


@pytest.mark.parametrize(
    ("state", "kind"),
    [
        ("40001", StorageBusy),
        ("40P01", StorageBusy),
        ("55P03", StorageBusy),
        ("53300", StorageBusy),
        ("53100", StorageFull),
        ("25006", StorageReadOnly),
        ("57P01", StorageUnavailable),
    ],
)
def test_errors_of_postgresql_have_the_same_names(store, state, kind):
    class DriverError(Exception):
        sqlstate = state

    with pytest.raises(kind) as named, store.catalog._database.writing():
        raise OperationalError("SELECT 1", {}, DriverError("so"))
    assert type(named.value) is kind


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("nonsense:secret", "TENSORMAP_CATALOG_URL"),
        ("mysql+pymysql://user:secret@127.0.0.1/maps", "wanted sqlite or postgresql"),
        ("postgresql+psycopg://user:secret@127.0.0.1:1/maps", "cannot be reached"),
        ("postgresql+psycopg://user:secret@127.0.0.1:port/maps", "TENSORMAP_CATALOG_URL"),
        ("postgresql+psycopg://user:an@secret@127.0.0.1:1/maps", "write it as %40"),
        ("postgresql+asyncpg2://user:secret@127.0.0.1:1/maps", "asyncpg2"),
        ("sqlite://", "names no file"),
        ("sqlite+pysqlite:///:memory:", "names no file"),
        ("sqlite:///file::memory:?uri=true", "names no file"),
        ("sqlite:///file:secret?mode=memory&uri=true", "names no file"),
        ("sqlite://secret/maps", "names no file"),
    ],
)
def test_an_error_about_the_catalogs_url_does_not_contain_its_password(url, message):
    with pytest.raises(StorageUnavailable, match=message) as raised:
        Catalog(url)
    assert "secret" not in with_cause(raised.value)


def test_an_error_of_sqlite_that_is_not_utf_8_is_named_too(tmp_path):
    with Store(tmp_path) as store:
        store.maps.create("north")
    path = tmp_path / "catalog.sqlite3"
    content = path.read_bytes()
    name = b"sqlite_autoindex_maps_1"
    path.write_bytes(content.replace(name, name[:-2] + b"\x80" + name[-1:]))
    with pytest.raises(StorageError, match="catalog's database fails"), Store(tmp_path) as store:
        store.maps.list()
