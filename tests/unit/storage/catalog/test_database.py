"""A database that fails is raised by name."""

import itertools
import shutil
import sqlite3
from concurrent.futures import ThreadPoolExecutor
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


def test_a_writer_does_not_wait_for_another_one_of_its_process_for_good(store, monkeypatch):
    monkeypatch.setattr(database, "_BUSY_TIMEOUT_S", 0.05)
    with ThreadPoolExecutor(1) as pool, store.catalog._database.writing():
        waiting = pool.submit(store.maps.create, "north")
        assert isinstance(waiting.exception(timeout=60), StorageBusy)
    store.maps.create("north")


def test_what_a_writer_waited_in_its_process_it_waits_less_for_another_process(store, monkeypatch):
    statements: list[str] = []
    with store.catalog._database.writing() as session:  # its connection is used again
        connection = session.connection().connection.dbapi_connection
    connection.set_trace_callback(statements.append)
    looks_s = itertools.count(100, 12)  # the clock goes on by 12 s from one look to the next
    monkeypatch.setattr(database, "time", SimpleNamespace(monotonic=lambda: next(looks_s)))
    store.maps.create("north")
    begin = statements.index("BEGIN IMMEDIATE")
    before, after = statements[begin - 1], statements[begin + 1]
    assert before == "PRAGMA busy_timeout = 18000"
    assert after == "PRAGMA busy_timeout = 30000"


def test_a_writer_that_waited_too_long_in_its_process_begins_only_if_nobody_else_writes(
    store, monkeypatch
):
    looks_s = itertools.count(100, 31)
    monkeypatch.setattr(database, "time", SimpleNamespace(monotonic=lambda: next(looks_s)))
    store.maps.create("north")
    other = sqlite3.connect(store.layout.catalog, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(StorageBusy):
        store.maps.create("south")
    other.close()
    store.maps.create("south")


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
