"""Backups of stores with damaged and missing files."""

import io
import shutil
import sqlite3

import h5py
import pytest

import storage.backup.backup
from storage.backup.backup import write_backup
from storage.backup.restore import Restored, restore_backup
from storage.errors import CorruptFile, StorageFull, StorageUnavailable, WrongCatalog
from storage.store import Store
from tests.support.backups import put
from tests.support.catalog_rows import stored_scans

pytestmark = pytest.mark.slow


def test_a_backup_leaves_out_a_file_that_is_gone_and_a_restore_lists_it(filled, tmp_path):
    put(filled, range(3), drive="tuesday")
    gone = {record.chunk for record in stored_scans(filled, "campus", "monday")[:2]}
    for path in filled.layout.maps.rglob("chunks/*.h5"):
        if path.name in gone:
            path.unlink()
    next(filled.layout.maps.rglob("revisions/*.h5")).unlink()
    written = write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert (written.files, len(written.missing), written.damaged) == (6, 3, ())
    restored = restore_backup(tmp_path / "b.tar", tmp_path / "new")
    assert (restored.files, set(restored.missing)) == (6, set(written.missing))
    names = [missing.partition(": the file is gone (maps/")[0] for missing in written.missing]
    revision = filled.revisions.list("campus").items[0].digest[:12]
    of_drive = "map campus, drive monday, scan"
    assert sorted(names) == [
        f"{of_drive} 0",
        f"{of_drive} 1",
        f"map campus, revision {revision}",
    ]
    with Store.serving(tmp_path / "new") as store:
        for drive, index in (("monday", 2), ("monday", 4), ("tuesday", 0)):
            assert store.drives.read_scan("campus", drive, index).points_m.size
        with pytest.raises(CorruptFile, match="is gone"):
            store.drives.read_scan("campus", "monday", 0)
        put(store, [5])
    again = write_backup(tmp_path / "new", tmp_path / "again.tar")
    assert (again.files, len(again.missing)) == (7, 3)


@pytest.mark.parametrize("lost", ["damaged", "missing"])
def test_an_incomplete_backup_is_written_beside_an_existing_one(filled, tmp_path, lost):
    data, path = filled.layout.data_dir, tmp_path / "b.tar"
    beside = tmp_path / "b.incomplete.tar"
    assert write_backup(data, path).path == path
    put(filled, [5])
    assert write_backup(data, path).path == path  # a whole one replaces it, as every night
    kept = path.read_bytes()
    chunk = next(filled.layout.maps.rglob("chunks/*.h5"))
    if lost == "damaged":
        chunk.write_bytes(chunk.read_bytes()[:-100])
    else:
        chunk.unlink()
    for _ in range(2):
        written = write_backup(data, path)
        assert (written.path, len(written.damaged + written.missing)) == (beside, 1)
    assert path.read_bytes() == kept
    assert sorted(tmp_path.glob("b*.tar")) == [beside, path]
    assert restore_backup(path, tmp_path / "good") == Restored(7, (), ())
    assert restore_backup(beside, tmp_path / "rest").files == written.files
    path.unlink()
    assert write_backup(data, path).path == path  # there is none to replace


def test_a_file_that_cannot_be_read_is_missing_in_the_backup(filled, tmp_path, monkeypatch):
    bad = next(filled.layout.maps.rglob("chunks/*.h5")).name
    add = storage.backup.backup._add

    class BadDisk(io.BytesIO):
        def read(self, size=-1, /):
            if size > 0:
                raise OSError(5, "Input/output error")
            return super().read(size)

    def of_bad_disk(tar, name, source):
        return add(tar, name, BadDisk(source.read()) if bad in name else source)

    monkeypatch.setattr(storage.backup.backup, "_add", of_bad_disk)
    written = write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert (written.files, written.damaged) == (5, ())
    [missing] = written.missing
    assert bad in missing
    assert "Input/output error" in missing
    restored = restore_backup(tmp_path / "b.tar", tmp_path / "new")
    assert restored == Restored(5, (), written.missing)
    assert not list((tmp_path / "new").rglob(bad))


@pytest.mark.parametrize(("which", "array"), [("chunks", "points_m"), ("revisions", "signatures")])
def test_a_damaged_file_is_reported_and_the_rest_is_restored(filled, tmp_path, which, array):
    path = next(filled.layout.maps.rglob(f"{which}/*.h5"))
    with h5py.File(path, "r+") as file:
        file[array][0] += 1.0
    written = write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert len(written.damaged) == 1
    assert written.damaged[0].endswith(f"({path.relative_to(filled.layout.data_dir)})")
    [revision] = filled.revisions.list("campus").items
    names = [
        *(f"drive monday, scan {index}" for index in range(5)),
        f"revision {revision.digest[:12]}",
    ]
    assert any(written.damaged[0].startswith(f"map campus, {name}: ") for name in names)
    assert written.missing == ()
    restored = restore_backup(tmp_path / "b.tar", tmp_path / "new")
    assert restored == Restored(6, written.damaged, ())


@pytest.mark.parametrize("lost", ["the catalog", "the store-id"])
def test_a_catalog_of_another_store_is_not_backed_up_and_the_backup_before_stays(
    filled, tmp_path, lost
):
    data, path = filled.layout.data_dir, tmp_path / "nightly.tar"
    write_backup(data, path)
    kept = path.read_bytes()
    filled.close()
    if lost == "the catalog":
        Store(tmp_path / "new").close()
        shutil.copy(tmp_path / "new" / "catalog.sqlite3", data / "catalog.sqlite3")
    else:
        (data / "store-id").unlink()
    with pytest.raises(WrongCatalog, match="belong together"):
        write_backup(data, path)
    assert path.read_bytes() == kept
    assert list(tmp_path.glob("*.tar*")) == [path]


def test_a_damaged_catalog_is_not_backed_up_and_the_backup_before_stays(filled, tmp_path):
    data, path = filled.layout.data_dir, tmp_path / "nightly.tar"
    write_backup(data, path)
    kept = path.read_bytes()
    filled.close()
    catalog = data / "catalog.sqlite3"
    content = bytearray(catalog.read_bytes())
    content[content.rindex(b"campus")] ^= 1  # of a row and of an index: one of them differs then
    catalog.write_bytes(content)
    with pytest.raises(CorruptFile, match="the copy of the catalog is damaged"):
        write_backup(data, path)
    assert path.read_bytes() == kept
    assert list(tmp_path.glob("*.tar*")) == [path]


@pytest.mark.parametrize(
    ("content", "error", "reason"),
    [
        (b"", CorruptFile, "the copy of the catalog cannot be read"),
        (b"no database", StorageUnavailable, "the catalog cannot be copied"),
    ],
)
def test_what_is_no_catalog_is_not_backed_up(filled, tmp_path, content, error, reason):
    data = filled.layout.data_dir
    filled.close()
    (data / "catalog.sqlite3").write_bytes(content)
    with pytest.raises(error, match=reason):
        write_backup(data, tmp_path / "b.tar")
    assert not list(tmp_path.glob("*.tar*"))


def test_a_backup_that_does_not_fit_is_refused_before_it_fills_the_disk_of_the_service(
    filled, tmp_path, monkeypatch
):
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=2**24 + 1000))
    needed = (
        rf"^a backup in {tmp_path} needs \d+ bytes; the disk has 16778216 left, 16777216 are kept"
    )
    with pytest.raises(StorageFull, match=needed):
        write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert not list(tmp_path.glob("*.tar*"))
    assert not list(tmp_path.glob(".*"))


def test_a_disk_that_is_too_small_for_the_catalog_of_a_backup_is_full_and_named(
    filled, tmp_path, monkeypatch
):
    connect = sqlite3.connect

    def connect_small(database, **options):
        connection = connect(database, **options)
        if not options:  # the copy
            connection.execute("PRAGMA max_page_count = 3")
        return connection

    monkeypatch.setattr(sqlite3, "connect", connect_small)
    with pytest.raises(StorageFull, match=r"no space is left in the folder of .*b\.tar"):
        write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert not list(tmp_path.glob("*.tar*"))
    assert not list(tmp_path.glob(".*"))
