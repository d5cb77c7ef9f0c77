"""A store and a catalog that do not belong together: rejected, and nothing is lost."""

import logging
import multiprocessing
import shutil
import sqlite3
import stat
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest
from alembic import command
from sqlalchemy import create_engine

from core.errors import InvalidParameters
from storage.catalog import Catalog
from storage.catalog.migrations import alembic_config
from storage.errors import DataDirInUse, StorageUnavailable, WrongCatalog
from storage.store import Store
from storage.store.identity import require_own_folder
from storage.store.layout import Layout
from tests.support.small_scans import sample_scan


def everything(folder):
    """Return the content of each file that is data."""
    return {
        path.relative_to(folder): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(("catalog", "server.lock"))
    }


@pytest.fixture
def stopped(tmp_path, data_dir_with_a_map):
    """The folder of a store with a scan, which nobody has open."""
    shutil.copytree(data_dir_with_a_map, tmp_path / "data")
    with Store(tmp_path / "data") as store:
        store.drives.put_scan("campus", "monday", 0, sample_scan(0))
    return tmp_path / "data"


def move_the_catalog_away(folder):
    (folder / "catalog.sqlite3").rename(folder.parent / "away.sqlite3")


def take_that_of_another(folder):
    with Store(folder.parent / "other") as other:
        other.maps.create("campus")
    shutil.copy(folder.parent / "other" / "catalog.sqlite3", folder / "catalog.sqlite3")


def lose_the_file(folder):
    (folder / "store-id").unlink()


def damage_the_file(folder):
    (folder / "store-id").write_bytes(b"\xff" * 33)


def lose_both(folder):
    move_the_catalog_away(folder)
    lose_the_file(folder)


@pytest.mark.parametrize(
    "harm",
    [move_the_catalog_away, take_that_of_another, lose_the_file, damage_the_file, lose_both],
)
@pytest.mark.parametrize("open_store", [Store, Store.serving])
def test_a_catalog_of_another_store_is_rejected_and_nothing_is_touched(stopped, harm, open_store):
    harm(stopped)
    before = everything(stopped)
    for _ in range(2):
        with pytest.raises(WrongCatalog, match="belong together"):
            open_store(stopped)
    assert everything(stopped) == before


def test_a_catalog_url_that_points_elsewhere_is_rejected(stopped, tmp_path):
    before = everything(stopped)
    with pytest.raises(WrongCatalog):
        Store.serving(stopped, f"sqlite:///{tmp_path / 'elsewhere.sqlite3'}")
    assert everything(stopped) == before
    with Store.serving(stopped) as store:
        assert store.drives.get("campus", "monday").scans == 1


def test_an_empty_folder_is_not_served_with_the_catalog_of_another(stopped, tmp_path):
    with pytest.raises(WrongCatalog):
        Store.serving(tmp_path / "new", f"sqlite:///{stopped / 'catalog.sqlite3'}")


def test_a_first_start_that_was_killed_between_the_two_is_repeated(tmp_path):
    (tmp_path / "store-id").write_text("0123456789abcdef" * 2)
    with Store.serving(tmp_path) as store:
        assert store.catalog.store_id.get() == "0123456789abcdef" * 2


def test_many_that_open_a_new_folder_at_once_agree(tmp_path):
    Catalog(f"sqlite:///{tmp_path / 'catalog.sqlite3'}").close()
    with ThreadPoolExecutor(6) as pool:
        stores = list(pool.map(Store, [tmp_path] * 6))
    assert len({store.catalog.store_id.get() for store in stores}) == 1
    for store in stores:
        store.close()


def test_files_that_an_older_catalog_does_not_have_are_moved_aside(stopped, caplog):
    older = stopped.parent / "older.sqlite3"
    shutil.copy(stopped / "catalog.sqlite3", older)
    with Store(stopped) as store:
        store.maps.create("harbour")
        store.drives.put_scan("harbour", "monday", 0, sample_scan(1))
        store.drives.put_scan("campus", "monday", 1, sample_scan(2))
    before = everything(stopped)
    shutil.copy(older, stopped / "catalog.sqlite3")
    with caplog.at_level(logging.WARNING, "tensormap.storage"), Store.serving(stopped) as store:
        assert store.drives.get("campus", "monday").scans == 1
    assert "2 files or folders" in caplog.text
    after = {
        Path(*path.parts[2:]) if path.parts[0] == "orphans" else path: content
        for path, content in everything(stopped).items()
    }
    assert after == before
    assert sum(path.parts[0] == "orphans" for path in everything(stopped)) == 2


def test_two_orphans_of_one_name_are_both_kept(stopped):
    for content in (b"first", b"second"):
        with Store.serving(stopped) as store:
            (store.layout.maps / "stray").write_bytes(content)
    Store.serving(stopped).close()
    kept = (stopped / "orphans").glob("*/maps/*")
    assert sorted(path.read_bytes() for path in kept) == [b"first", b"second"]


def all_in(folder):
    """Return the content and mode of all files and folders in a folder."""
    return {
        path: (path.stat().st_mode, path.read_bytes() if path.is_file() else b"")
        for path in (folder, *folder.rglob("*"))
    }


@pytest.mark.parametrize("harm", [move_the_catalog_away, lose_both])
@pytest.mark.parametrize("open_store", [Store, Store.serving])
def test_no_new_catalog_is_made_in_place_of_a_lost_one(stopped, harm, open_store):
    harm(stopped)
    before = all_in(stopped)
    with pytest.raises(WrongCatalog, match="none"):
        open_store(stopped)
    assert all_in(stopped) == before


def test_a_new_database_is_not_filled_for_a_folder_that_has_lost_its_catalog(stopped, new_database):
    url = new_database("sqlite")
    with pytest.raises(WrongCatalog, match="none"):
        Store.serving(stopped, url)
    with closing(sqlite3.connect(url.removeprefix("sqlite:///"))) as connection, connection:
        assert connection.execute("SELECT name FROM sqlite_master").fetchall() == []
    connection.close()


@pytest.mark.parametrize("open_store", [Store, Store.serving])
@pytest.mark.parametrize(
    ("url", "error"),
    [
        ("mysql+pymysql://user@127.0.0.1/maps", StorageUnavailable),
        ("postgresql+psycopg://user@127.0.0.1:1/maps", StorageUnavailable),
        ("sqlite:///{of_another}", WrongCatalog),
    ],
)
def test_a_catalog_url_that_is_refused_leaves_no_new_folder(
    stopped, tmp_path, open_store, url, error
):
    with pytest.raises(error):
        open_store(tmp_path / "new", url.format(of_another=stopped / "catalog.sqlite3"))
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("open_store", [Store, Store.serving])
@pytest.mark.parametrize("table", ["t", "maps"])
def test_the_database_of_another_program_is_not_taken_for_a_catalog(tmp_path, open_store, table):
    folder = tmp_path / "theirs"
    folder.mkdir(0o755)
    with closing(sqlite3.connect(folder / "catalog.sqlite3")) as connection, connection:
        connection.execute(f"CREATE TABLE {table} (x)")
    connection.close()
    before = all_in(folder)
    with pytest.raises(WrongCatalog, match=f"no catalog of TensorMap.*'{table}'"):
        open_store(folder)
    assert all_in(folder) == before


def test_an_empty_catalog_is_one_of_a_killed_first_start_and_makes_no_data_directory(tmp_path):
    (tmp_path / "catalog.sqlite3").touch()
    (tmp_path / "thesis.txt").touch()
    with pytest.raises(InvalidParameters, match=r"'thesis\.txt'"):
        Store.serving(tmp_path)
    assert (tmp_path / "catalog.sqlite3").stat().st_size == 0
    (tmp_path / "thesis.txt").unlink()
    with Store.serving(tmp_path) as store:
        store.maps.create("campus")


def downgrade(folder, schema):
    """Bring the catalog of a folder to the schema of an older release."""
    engine = create_engine(f"sqlite:///{folder / 'catalog.sqlite3'}")
    config = alembic_config()
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        command.downgrade(config, schema)
    engine.dispose()


def catalog_of(folder):
    """Return the schema and the content of a catalog that nobody has open."""
    connection = sqlite3.connect(folder / "catalog.sqlite3")
    dumped = list(connection.iterdump())
    connection.close()
    return dumped


@pytest.mark.parametrize("open_store", [Store, Store.serving])
@pytest.mark.parametrize("name", ["new", "empty", "used"])
def test_an_older_catalog_of_another_store_is_rejected_before_it_is_migrated(
    stopped, tmp_path, open_store, name
):
    downgrade(stopped, "0016")
    before = catalog_of(stopped)
    (tmp_path / "empty").mkdir()
    with Store(tmp_path / "used") as used:
        used.maps.create("campus")
    with pytest.raises(WrongCatalog, match="belong together"):
        open_store(tmp_path / name, f"sqlite:///{stopped / 'catalog.sqlite3'}")
    assert catalog_of(stopped) == before
    assert not (tmp_path / "new").exists()
    assert list((tmp_path / "empty").iterdir()) == []
    with open_store(stopped) as store:  # its own is migrated
        assert store.drives.get("campus", "monday").scans == 1


def _pretend_an_older_schema(folder):
    with closing(sqlite3.connect(folder / "catalog.sqlite3")) as connection, connection:
        for table in ("store", "keys", "jobs", "live_revisions", "revisions", "scans", "drives"):
            connection.execute(f"DROP TABLE {table}")
        connection.execute("DROP TABLE maps")
        connection.execute("DELETE FROM alembic_version")
    connection.close()


def _schema(folder):
    with closing(sqlite3.connect(folder / "catalog.sqlite3")) as connection, connection:
        found = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
    connection.close()
    return found


@pytest.mark.parametrize("open_store", [Store, Store.serving])
def test_a_catalog_is_not_migrated_under_a_running_server(tmp_path, open_store):
    with Store.serving(tmp_path):
        _pretend_an_older_schema(tmp_path)
        before = _schema(tmp_path)
        with pytest.raises(DataDirInUse):
            open_store(tmp_path)
        assert _schema(tmp_path) == before


def test_a_catalog_of_a_newer_version_is_rejected(stopped):
    with closing(sqlite3.connect(stopped / "catalog.sqlite3")) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    connection.close()
    for open_store in (Store, Store.serving):
        with pytest.raises(WrongCatalog, match="9999"):
            open_store(stopped)


def test_a_server_that_was_rejected_leaves_the_folder_free(stopped):
    (stopped / "store-id").rename(stopped / "kept")
    with pytest.raises(WrongCatalog):
        Store.serving(stopped)
    (stopped / "kept").rename(stopped / "store-id")
    Store.serving(stopped).close()


def _open(folder):
    Store(folder).close()


def test_a_worker_opens_the_store_of_a_running_server(tmp_path):
    with Store.serving(tmp_path):
        worker = multiprocessing.get_context("forkserver").Process(target=_open, args=(tmp_path,))
        worker.start()
        worker.join()
        assert worker.exitcode == 0


@pytest.mark.parametrize("held", ["thesis.txt", "maps/berlin.osm", ".ssh/id"])
def test_a_folder_of_something_else_is_not_served_and_stays_as_it_is(tmp_path, held):
    folder = tmp_path / "home"
    (folder / held).parent.mkdir(parents=True)
    (folder / held).write_text("mine")
    folder.chmod(0o755)
    with pytest.raises(InvalidParameters, match="is no data directory"):
        Store.serving(folder)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o755
    assert everything(folder) == {Path(held): b"mine"}
    assert not (folder / "server.lock").exists()


@pytest.mark.parametrize("held", [[], ["lost+found"]])
def test_an_empty_folder_is_served_also_that_of_a_file_system(tmp_path, held):
    for name in held:
        (tmp_path / name).mkdir()
    with Store.serving(tmp_path) as store:
        store.maps.create("campus")
    (tmp_path / "backup.tar").touch()  # what is beside its own files matters to no start
    with Store.serving(tmp_path) as store:
        assert store.maps.get("campus").slug == "campus"


def test_a_folder_whose_catalog_is_elsewhere_is_known_by_its_store_id(stopped, tmp_path):
    move_the_catalog_away(stopped)
    (stopped / "server.lock").unlink(missing_ok=True)
    with Store.serving(stopped, f"sqlite:///{tmp_path / 'away.sqlite3'}") as store:
        assert store.drives.get("campus", "monday").scans == 1


def test_a_folder_from_before_store_ids_is_known_by_its_lock(tmp_path):
    (tmp_path / "maps").mkdir()
    with pytest.raises(InvalidParameters, match="'maps'"):
        require_own_folder(Layout(tmp_path))
    (tmp_path / "server.lock").touch()
    require_own_folder(Layout(tmp_path))
