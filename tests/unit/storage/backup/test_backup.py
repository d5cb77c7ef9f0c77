"""Backups: consistent while everything changes, and restored whole or not at all."""

import io
import json
import sqlite3
import stat
import tarfile
import threading
from contextlib import closing

import h5py
import numpy as np
import pytest

import storage.backup.backup
from core.errors import InvalidParameters
from core.scans.scan import Scan
from storage.backup.backup import write_backup
from storage.backup.restore import Restored, restore_backup
from storage.catalog import RevisionFacts
from storage.errors import CorruptFile
from storage.files.claims import claimed
from storage.files.map_file import write_map
from storage.store import Store
from tests.support.catalog_rows import stored_scans
from tests.support.samples import sample_map

pytestmark = pytest.mark.slow

FACTS = RevisionFacts(encoding="paper", scans=24, segments=3, parameters={})


def scan_of(seed):
    return Scan(np.random.default_rng(seed).normal(scale=10, size=(150, 3)).astype(np.float32))


def put(store, indices, drive="monday"):
    for index in indices:
        store.drives.put_scan("campus", drive, index, scan_of(index))


def add_revision(store, seed=0):
    tensor_map, _ = sample_map(seed=seed)
    map_id = store.maps.get("campus").id
    return store.revisions.add(
        map_id, tensor_map.revision, lambda path: write_map(path, tensor_map), FACTS
    )


@pytest.fixture
def filled(store):
    put(store, range(5))
    add_revision(store)
    return store


@pytest.fixture
def backup(filled, tmp_path):
    path = tmp_path / "backup.tar"
    write_backup(filled.layout.data_dir, path)
    return path


def test_a_restored_store_is_the_one_that_was_backed_up(filled, tmp_path):
    filled.jobs.create("campus", {"a": 1})
    filled.keys.add("hash", ["admin"])
    path = tmp_path / "backup.tar"
    told = write_backup(filled.layout.data_dir, path)
    assert (told.files, told.size_bytes) == (6, path.stat().st_size)
    assert (told.damaged, told.missing) == ((), ())
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    put(filled, [5])  # later than the backup
    assert restore_backup(path, tmp_path / "new") == Restored(6, (), ())
    with Store.serving(tmp_path / "new") as restored:
        assert restored.maps.list() == filled.maps.list()
        assert restored.jobs.list() == filled.jobs.list()
        assert restored.keys.list() == filled.keys.list()
        assert restored.revisions.live("campus") == filled.revisions.live("campus")
        assert restored.drives.get("campus", "monday").scans == 5
        for index in range(5):
            read = restored.drives.read_scan("campus", "monday", index)
            assert read.points_m.tobytes() == scan_of(index).points_m.tobytes()
        assert not restored.layout.orphans.exists()
        put(restored, [5])  # it goes on
    assert sorted(p.name for p in tmp_path.iterdir()) == ["backup.tar", "data", "new"]


def test_an_empty_store_is_backed_up_and_restored(tmp_path):
    Store(tmp_path / "data").close()
    assert write_backup(tmp_path / "data", tmp_path / "b.tar").files == 0
    assert restore_backup(tmp_path / "b.tar", tmp_path / "new").files == 0
    with Store.serving(tmp_path / "new") as restored:
        assert restored.maps.list().items == ()


def test_a_backup_under_load_holds_every_scan_that_was_acknowledged_before_it(store, tmp_path):
    acknowledged, stop = [], threading.Event()

    def work():
        for number in range(10_000):
            if stop.is_set():
                return
            put(store, [number], drive=f"drive-{number % 3}")
            acknowledged.append(number)
            if number % 7 == 6:
                store.drives.delete("campus", "drive-0")
            if number % 5 == 4:
                store.drives.close("campus", "drive-1")  # compacted: files change places
                store.drives.delete("campus", "drive-1")

    worker = threading.Thread(target=work)
    worker.start()
    try:
        for number in range(4):
            before = {n for n in acknowledged if n % 3 == 2}
            write_backup(store.layout.data_dir, tmp_path / f"{number}.tar")
            restore_backup(tmp_path / f"{number}.tar", tmp_path / f"new-{number}")
            with Store.serving(tmp_path / f"new-{number}") as restored:
                assert not restored.layout.orphans.exists()
                held = set()
                for drive in restored.drives.list("campus").items:
                    for record in stored_scans(restored, "campus", drive.slug):
                        restored.drives.read_scan("campus", drive.slug, record.index)
                        if drive.slug == "drive-2":
                            held.add(record.index)
                assert before <= held
    finally:
        stop.set()
        worker.join()


def test_a_drive_that_is_deleted_while_it_is_copied_is_not_in_the_backup(
    filled, tmp_path, monkeypatch
):
    put(filled, range(3), drive="tuesday")
    named = storage.backup.backup.named_files
    deleted: list[object] = []

    def delete_after_naming(catalog):
        files = named(catalog)
        if not deleted:
            deleted.append(filled.drives.delete("campus", "tuesday"))
        return files

    monkeypatch.setattr(storage.backup.backup, "named_files", delete_after_naming)
    assert write_backup(filled.layout.data_dir, tmp_path / "b.tar").files == 6
    restore_backup(tmp_path / "b.tar", tmp_path / "new")
    with Store.serving(tmp_path / "new") as restored:
        assert restored.drives.slugs("campus") == ("monday",)
        assert not restored.layout.orphans.exists()


def test_of_a_drive_that_is_deleted_once_it_was_copied_not_even_a_folder_is_restored(
    filled, tmp_path, monkeypatch
):
    for drive in ("tuesday", "wednesday"):
        put(filled, range(2), drive=drive)
    add = storage.backup.backup._add
    of_both = [filled.drives.get("campus", drive).id for drive in ("tuesday", "wednesday")]
    copied: list[str] = []

    def delete_after_the_first(tar, name, source):
        told = add(tar, name, source)
        if not copied and any(drive in name for drive in of_both):
            copied.append(name)
            for drive in ("tuesday", "wednesday"):
                filled.drives.delete("campus", drive)
        return told

    monkeypatch.setattr(storage.backup.backup, "_add", delete_after_the_first)
    assert write_backup(filled.layout.data_dir, tmp_path / "b.tar").files == 6
    assert len(copied) == 1
    assert restore_backup(tmp_path / "b.tar", tmp_path / "new").files == 6
    with Store.serving(tmp_path / "new") as restored:
        assert not restored.layout.orphans.exists()


def test_a_backup_goes_on_without_a_file_that_is_gone_and_a_restore_says_what_it_lacks(
    filled, tmp_path
):
    put(filled, range(3), drive="tuesday")
    gone = {record.chunk for record in stored_scans(filled, "campus", "monday")[:2]}
    for path in filled.layout.maps.rglob("chunks/*.h5"):
        if path.name in gone:
            path.unlink()
    next(filled.layout.maps.rglob("revisions/*.h5")).unlink()
    told = write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert (told.files, len(told.missing), told.damaged) == (6, 3, ())
    restored = restore_backup(tmp_path / "b.tar", tmp_path / "new")
    assert (restored.files, set(restored.missing)) == (6, set(told.missing))
    names = [said.partition(": the file is gone (maps/")[0] for said in told.missing]
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
def test_an_incomplete_backup_goes_beside_the_one_that_is_there(filled, tmp_path, lost):
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
        told = write_backup(data, path)
        assert (told.path, len(told.damaged + told.missing)) == (beside, 1)
    assert path.read_bytes() == kept
    assert sorted(tmp_path.glob("b*.tar")) == [beside, path]
    assert restore_backup(path, tmp_path / "good") == Restored(7, (), ())
    assert restore_backup(beside, tmp_path / "rest").files == told.files
    path.unlink()
    assert write_backup(data, path).path == path  # nothing is there that it would replace


def test_what_the_disk_does_not_give_is_missing_in_the_backup(filled, tmp_path, monkeypatch):
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
    told = write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert (told.files, told.damaged) == (5, ())
    [said] = told.missing
    assert bad in said
    assert "Input/output error" in said
    restored = restore_backup(tmp_path / "b.tar", tmp_path / "new")
    assert restored == Restored(5, (), told.missing)
    assert not list((tmp_path / "new").rglob(bad))


def test_a_backup_removes_what_killed_ones_left_beside_it_and_nothing_else(filled, tmp_path):
    old, held, own, other = (
        tmp_path / name
        for name in (
            ".backup-a1b2c3d4",
            ".tensormap-backup-held",
            ".backup-personal",
            ".x.tar.1.part",
        )
    )
    for folder, file in (
        (old, "catalog.sqlite3-journal"),
        (held, "catalog.sqlite3"),
        (own, "diary"),
    ):
        folder.mkdir()
        (folder / file).touch()
    other.touch()
    part = tmp_path / ".b.tar.0123.part"
    part.touch()
    with claimed(held):  # by a backup that runs
        write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert not old.exists()
    assert not part.exists()
    assert held.exists()
    assert (own / "diary").exists()
    assert other.exists()  # of a backup of another name
    write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert not held.exists()


def test_a_restore_removes_what_a_killed_one_left(backup, tmp_path):
    left = tmp_path / ".new.restore-a1b2"
    (left / "maps").mkdir(parents=True)
    restore_backup(backup, tmp_path / "new")
    assert not left.exists()


@pytest.mark.parametrize(("which", "array"), [("chunks", "points_m"), ("revisions", "signatures")])
def test_what_is_damaged_is_told_and_the_rest_is_safe(filled, tmp_path, which, array):
    path = next(filled.layout.maps.rglob(f"{which}/*.h5"))
    with h5py.File(path, "r+") as file:
        file[array][0] += 1.0
    told = write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert len(told.damaged) == 1
    assert told.damaged[0].endswith(f"({path.relative_to(filled.layout.data_dir)})")
    [revision] = filled.revisions.list("campus").items
    names = [
        *(f"drive monday, scan {index}" for index in range(5)),
        f"revision {revision.digest[:12]}",
    ]
    assert any(told.damaged[0].startswith(f"map campus, {name}: ") for name in names)
    assert told.missing == ()
    restored = restore_backup(tmp_path / "b.tar", tmp_path / "new")
    assert restored == Restored(6, told.damaged, ())


def test_a_folder_with_something_in_it_is_not_restored_into(backup, tmp_path):
    target = tmp_path / "there"
    target.mkdir()
    (target / "file").write_text("mine")
    with pytest.raises(InvalidParameters, match="there already"):
        restore_backup(backup, target)
    with pytest.raises(InvalidParameters, match="there already"):
        restore_backup(backup, target / "file")
    assert (target / "file").read_text() == "mine"
    (target / "file").unlink()
    assert restore_backup(backup, target).files == 6


def test_a_folder_without_a_catalog_is_not_backed_up(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_backup(tmp_path, tmp_path / "b.tar")
    assert list(tmp_path.iterdir()) == []


def members(path):
    with tarfile.open(path) as tar:
        found = []
        for member in tar:
            content = tar.extractfile(member)
            assert content is not None
            found.append((member, content.read()))
        return found


def rewrite(path, content):
    with tarfile.open(path, "w") as tar:
        for member, body in content:
            member.size = len(body)
            tar.addfile(member, io.BytesIO(body))


def refuse(backup, tmp_path, match=None):
    before = sorted(tmp_path.iterdir())
    with pytest.raises(CorruptFile, match=match):
        restore_backup(backup, tmp_path / "new")
    assert sorted(tmp_path.iterdir()) == before


def test_a_backup_that_is_cut_off_anywhere_is_refused(backup, tmp_path):
    whole = backup.read_bytes()
    with tarfile.open(backup) as tar:
        last = tar.getmembers()[-1]
    end = last.offset_data + last.size  # what follows is padding
    for share in (0.0, 0.1, 0.5, 0.9, 0.97):
        backup.write_bytes(whole[: int(share * end)])
        refuse(backup, tmp_path)


def test_a_backup_with_a_changed_byte_is_refused(backup, tmp_path):
    content = members(backup)
    for number, (member, body) in enumerate(content):
        changed = bytearray(body)
        changed[len(body) // 2] ^= 1
        rewrite(backup, [*content[:number], (member, bytes(changed)), *content[number + 1 :]])
        refuse(backup, tmp_path)


def test_a_backup_without_one_of_its_files_is_refused(backup, tmp_path):
    content = members(backup)
    for number in range(len(content)):
        rewrite(backup, content[:number] + content[number + 1 :])
        refuse(backup, tmp_path)


@pytest.mark.parametrize(
    "name",
    [
        "../outside",
        "/tmp/outside",
        "maps/../../outside",
        "maps/x.h5",
        "catalog.sqlite3-wal",
        "maps/" + "0" * 32 + "/revisions/../../../outside.h5",
    ],
)
def test_no_name_in_a_backup_leads_out_of_the_folder(backup, tmp_path, name):
    content = [(tarfile.TarInfo(name), b"evil"), *members(backup)]
    rewrite(backup, content)
    refuse(backup, tmp_path, "cannot be part")
    assert not (tmp_path / "outside").exists()


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.FIFOTYPE])
def test_links_and_devices_in_a_backup_are_refused(backup, tmp_path, kind):
    content = members(backup)
    link = tarfile.TarInfo("store-id")
    link.type, link.linkname = kind, "/etc/passwd"
    rewrite(backup, [(link, b""), *content])
    refuse(backup, tmp_path, "cannot be part")


def test_a_file_twice_in_a_backup_is_refused(backup, tmp_path):
    content = members(backup)
    rewrite(backup, [content[0], *content])
    refuse(backup, tmp_path, "twice")


def test_a_catalog_that_names_more_than_the_manifest_is_refused(backup, tmp_path):
    content = members(backup)
    manifest = json.loads(content[-1][1])
    path = next(name for name in manifest["files"] if "chunks" in name)
    del manifest["files"][path]
    rewrite(backup, [*content[:-1], (content[-1][0], json.dumps(manifest).encode())])
    refuse(backup, tmp_path, "lacks maps/")


def test_the_catalog_in_a_backup_is_a_plain_database(backup, tmp_path):
    body = {member.name: body for member, body in members(backup)}["catalog.sqlite3"]
    path = tmp_path / "catalog.sqlite3"
    path.write_bytes(body)
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT slug FROM maps").fetchall() == [("campus",)]
