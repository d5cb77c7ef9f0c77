"""Backups: consistent while the store changes."""

import fcntl
import os
import shutil
import sqlite3
import stat
import threading
from contextlib import closing
from pathlib import Path

import pytest

import storage.backup.backup
import storage.backup.restore
import storage.files.files
from storage.backup import catalog_copy
from storage.backup.backup import write_backup
from storage.backup.restore import Restored, restore_backup
from storage.files.claims import claimed
from storage.store import Store
from tests.support.backups import members, put, scan_of
from tests.support.catalog_rows import stored_scans
from tests.support.samples import RecordedProgress

pytestmark = pytest.mark.slow

BESIDE_FILES = ("catalog.sqlite3", "store-id")


def test_a_restored_store_is_the_one_that_was_backed_up(filled, tmp_path):
    filled.jobs.create("campus", {"a": 1})
    filled.keys.add("hash", ["admin"])
    path = tmp_path / "backup.tar"
    written = write_backup(filled.layout.data_dir, path)
    assert (written.files, written.size_bytes) == (6, path.stat().st_size)
    assert (written.damaged, written.missing) == ((), ())
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
        put(restored, [5])  # it can be written
    assert sorted(p.name for p in tmp_path.iterdir()) == ["backup.tar", "data", "new"]


def test_a_backup_and_a_restore_report_how_far_they_are(filled, tmp_path, monkeypatch):
    monkeypatch.setattr(storage.backup.restore, "_MB", unit := 10**3)  # the store is small
    backing_up, restoring = RecordedProgress(), RecordedProgress()
    written = write_backup(filled.layout.data_dir, tmp_path / "b.tar", backing_up)
    assert (backing_up.stages, backing_up.done) == ([("copying", 6)], [6])
    restore_backup(tmp_path / "b.tar", tmp_path / "new", restoring)
    megabytes = written.size_bytes // unit
    assert megabytes > 0
    assert restoring.stages == [("unpacking MB", megabytes), ("syncing", 6 + len(BESIDE_FILES))]
    assert restoring.done == [megabytes, 6 + len(BESIDE_FILES)]


def test_an_empty_store_is_backed_up_and_restored(tmp_path):
    Store(tmp_path / "data").close()
    assert write_backup(tmp_path / "data", tmp_path / "b.tar").files == 0
    assert restore_backup(tmp_path / "b.tar", tmp_path / "new").files == 0
    with Store.serving(tmp_path / "new") as restored:
        assert restored.maps.list().items == ()


def test_a_backup_to_a_link_is_the_file_that_it_leads_to(filled, tmp_path):
    (tmp_path / "nas").mkdir()
    target, link = tmp_path / "nas" / "backup.tar", tmp_path / "b.tar"
    link.symlink_to(target)
    for _ in range(2):
        assert write_backup(filled.layout.data_dir, link).path == target
        assert link.readlink() == target
        assert restore_backup(link, tmp_path / "new").files == 6
        shutil.rmtree(tmp_path / "new")
    next(filled.layout.maps.rglob("chunks/*.h5")).unlink()
    beside = target.with_name("backup.incomplete.tar")
    assert write_backup(filled.layout.data_dir, link).path == beside
    assert sorted(tmp_path.glob("*")) == [link, filled.layout.data_dir, target.parent]
    assert sorted(target.parent.glob("*")) == [beside, target]


def test_a_backup_under_load_holds_every_scan_that_was_acknowledged_before_it(store, tmp_path):
    acknowledged, stop = [], threading.Event()

    def work():
        for number in range(10_000):
            if stop.is_set():
                return
            put(store, [number], drive=f"drive-{number % 3}")
            acknowledged.append(number)
            if number % 7 == 6:
                store.drives.purge("campus", "drive-0")
            if number % 5 == 4:
                store.drives.close("campus", "drive-1")  # compacted: files change places
                store.drives.purge("campus", "drive-1")

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


def test_a_drive_that_is_purged_while_it_is_copied_is_not_in_the_backup(
    filled, tmp_path, monkeypatch
):
    put(filled, range(3), drive="tuesday")
    named = catalog_copy.named_files
    deleted: list[object] = []

    def delete_after_naming(catalog):
        files = named(catalog)
        if not deleted:
            deleted.append(filled.drives.purge("campus", "tuesday"))
        return files

    monkeypatch.setattr(storage.backup.backup, "named_files", delete_after_naming)
    assert write_backup(filled.layout.data_dir, tmp_path / "b.tar").files == 6
    restore_backup(tmp_path / "b.tar", tmp_path / "new")
    with Store.serving(tmp_path / "new") as restored:
        assert restored.drives.slugs("campus") == ("monday",)
        assert not restored.layout.orphans.exists()


def test_no_folder_of_a_drive_that_is_purged_after_it_was_copied_is_restored(
    filled, tmp_path, monkeypatch
):
    for drive in ("tuesday", "wednesday"):
        put(filled, range(2), drive=drive)
    add = storage.backup.backup._add
    of_both = [filled.drives.get("campus", drive).id for drive in ("tuesday", "wednesday")]
    copied: list[str] = []

    def delete_after_the_first(tar, name, source):
        written = add(tar, name, source)
        if not copied and any(drive in name for drive in of_both):
            copied.append(name)
            for drive in ("tuesday", "wednesday"):
                filled.drives.purge("campus", drive)
        return written

    monkeypatch.setattr(storage.backup.backup, "_add", delete_after_the_first)
    assert write_backup(filled.layout.data_dir, tmp_path / "b.tar").files == 6
    assert len(copied) == 1
    assert restore_backup(tmp_path / "b.tar", tmp_path / "new").files == 6
    with Store.serving(tmp_path / "new") as restored:
        assert not restored.layout.orphans.exists()


def test_a_backup_removes_the_files_of_killed_ones_beside_it_and_no_others(filled, tmp_path):
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
    with claimed(lambda: held):  # by a backup that runs
        write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert not old.exists()
    assert not part.exists()
    assert held.exists()
    assert (own / "diary").exists()
    assert other.exists()  # of a backup of another name
    write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert not held.exists()


def test_two_backups_to_one_name_at_the_same_moment_are_both_written(filled, tmp_path, monkeypatch):
    lock, raced = fcntl.flock, []

    def lock_late(descriptor, operation):
        """Let another backup list the first folder, and the first file, before it is locked."""
        kind = stat.S_IFMT(os.fstat(descriptor).st_mode)
        if operation == fcntl.LOCK_EX and kind not in raced:
            raced.append(kind)
            with monkeypatch.context() as other:
                other.setattr(fcntl, "flock", lock)
                write_backup(filled.layout.data_dir, tmp_path / "b.tar")
        lock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", lock_late)
    assert write_backup(filled.layout.data_dir, tmp_path / "b.tar").files == 6
    assert restore_backup(tmp_path / "b.tar", tmp_path / "new").files == 6
    assert raced == [stat.S_IFDIR, stat.S_IFREG]
    assert list(tmp_path.glob(".*")) == []


def test_a_backup_that_waits_for_its_disk_is_not_removed_by_another_one(
    filled, tmp_path, monkeypatch
):
    sync = storage.files.files.sync
    waited: list[Path] = []

    def sync_late(path):
        """Let another backup to the same name begin and end while a large file is synced."""
        if path.suffix == ".part" and not waited:
            waited.append(path)
            write_backup(filled.layout.data_dir, tmp_path / "b.tar")
        sync(path)

    monkeypatch.setattr(storage.files.files, "sync", sync_late)
    assert write_backup(filled.layout.data_dir, tmp_path / "b.tar").files == 6
    assert restore_backup(tmp_path / "b.tar", tmp_path / "new").files == 6
    assert len(waited) == 1
    assert list(tmp_path.glob(".*")) == []


def test_brackets_in_the_name_of_a_backup_are_of_its_name_and_no_pattern(filled, tmp_path):
    own, other = tmp_path / ".b[1].tar.0123.part", tmp_path / ".b1.tar.0123.part"
    own.touch()
    other.touch()
    write_backup(filled.layout.data_dir, tmp_path / "b[1].tar")
    assert not own.exists()
    assert other.exists()


@pytest.mark.parametrize("error", [FileNotFoundError, PermissionError])
def test_a_copy_of_another_backup_that_ends_or_is_of_another_user_stops_none(
    filled, tmp_path, monkeypatch, error
):
    theirs, listed = tmp_path / ".tensormap-backup-theirs", Path.iterdir
    theirs.mkdir()

    def iterdir(path):
        if path == theirs:
            raise error(path)
        return listed(path)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    assert write_backup(filled.layout.data_dir, tmp_path / "b.tar").files == 6


def test_a_folder_without_a_catalog_is_not_backed_up(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_backup(tmp_path, tmp_path / "b.tar")
    assert list(tmp_path.iterdir()) == []


def test_the_catalog_in_a_backup_is_a_plain_database(backup, tmp_path):
    body = {member.name: body for member, body in members(backup)}["catalog.sqlite3"]
    path = tmp_path / "catalog.sqlite3"
    path.write_bytes(body)
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT slug FROM maps").fetchall() == [("campus",)]
