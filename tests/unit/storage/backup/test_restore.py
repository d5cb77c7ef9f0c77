"""Restores: whole or not at all."""

import errno
import hashlib
import json
import os
import shutil
import tarfile
from pathlib import Path

import pytest

import storage.backup.restore
from core.errors import InvalidParameters
from storage.backup.restore import restore_backup
from storage.errors import CorruptFile, StorageFull, StorageUnavailable, WrongCatalog
from storage.store import Store
from storage.store.clock import ClockWatch
from tests.support.backups import members, rewrite

pytestmark = pytest.mark.slow


def require_rejected(backup, tmp_path, match=None):
    before = sorted(tmp_path.iterdir())
    with pytest.raises(CorruptFile, match=match):
        restore_backup(backup, tmp_path / "new")
    assert sorted(tmp_path.iterdir()) == before


def test_a_restore_removes_the_folder_of_a_killed_one(backup, tmp_path):
    left = tmp_path / ".new.restore-a1b2"
    (left / "maps").mkdir(parents=True)
    restore_backup(backup, tmp_path / "new")
    assert not left.exists()


def test_brackets_in_the_name_of_a_folder_are_of_its_name_and_no_pattern(backup, tmp_path):
    own, other = tmp_path / ".new[1].restore-1", tmp_path / ".new1.restore-1"
    own.mkdir()
    other.mkdir()
    restore_backup(backup, tmp_path / "new[1]")
    assert not own.exists()
    assert other.exists()


def test_a_restore_rejects_a_folder_that_is_not_empty(backup, tmp_path):
    target = tmp_path / "there"
    target.mkdir()
    (target / "file").write_text("mine")
    with pytest.raises(InvalidParameters, match="there already"):
        restore_backup(backup, target)
    with pytest.raises(InvalidParameters, match="there already"):
        restore_backup(backup, target / "file")
    assert (target / "file").read_text() == "mine"


def test_a_restore_rejects_a_link_to_a_folder_that_is_not_there_before_it_unpacks(backup, tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "of a disk")
    with pytest.raises(FileNotFoundError, match="links to a folder that is not there"):
        restore_backup(backup, tmp_path / "link")
    assert [path.name for path in tmp_path.iterdir() if "restore" in path.name] == []


def test_a_folder_that_is_empty_is_filled_and_not_replaced_as_a_mount_point_cannot_be(
    backup, tmp_path
):
    target = tmp_path / "there"
    (target / "lost+found").mkdir(parents=True)
    (target / ".restore-a1b2" / "maps").mkdir(parents=True)  # of a killed one
    number = target.stat().st_ino
    assert restore_backup(backup, target).files == 6
    assert target.stat().st_ino == number
    assert {path.name for path in target.iterdir()} == {
        "catalog.sqlite3",
        "clock.json",
        "lost+found",
        "maps",
        "store-id",
    }
    with Store.serving(target) as store:
        assert len(store.drives.list("campus").items) == 1


def test_what_a_killed_restore_leaves_in_an_empty_folder_is_opened_by_no_service(backup, tmp_path):
    target = tmp_path / "there"
    restore_backup(backup, target)
    (target / "store-id").unlink()  # the last one to be moved there
    with pytest.raises(WrongCatalog):
        Store.serving(target)
    with pytest.raises(InvalidParameters, match="there already"):
        restore_backup(backup, target)


def test_a_restore_into_an_empty_folder_that_fails_leaves_it_empty(backup, tmp_path, monkeypatch):
    target = tmp_path / "there"
    target.mkdir()
    renamed = []

    def rename(path, to):
        if path.name == "store-id":
            raise OSError(errno.EIO, "Input/output error")
        if to.parent == target:
            renamed.append(path.name)
        path.replace(to)

    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises(StorageUnavailable):
        restore_backup(backup, target)
    # Without its store-id no service opens it.
    assert set(renamed) == {"catalog.sqlite3", "clock.json", "maps"}
    assert not list(target.iterdir())


def test_a_restore_that_cannot_make_its_service_wait_fails_as_old_deletions_would_be_removed(
    backup, tmp_path, monkeypatch
):
    written = Path.write_text

    def write_text(path, *arguments, **options):
        if path.name.startswith(".clock.json."):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return written(path, *arguments, **options)

    before = sorted(tmp_path.iterdir())
    with monkeypatch.context() as full:
        full.setattr(Path, "write_text", write_text)
        with pytest.raises(StorageFull):
            restore_backup(backup, tmp_path / "new")
    assert sorted(tmp_path.iterdir()) == before
    restore_backup(backup, tmp_path / "new")
    assert not ClockWatch(tmp_path / "new" / "clock.json").is_trusted()


def test_a_restore_that_does_not_fit_is_refused_before_anything_is_unpacked(
    backup, tmp_path, monkeypatch
):
    before, size_bytes = sorted(tmp_path.iterdir()), backup.stat().st_size
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=size_bytes - 1))
    needed = f"needs {size_bytes} bytes; the disk has {size_bytes - 1} left$"
    with pytest.raises(StorageFull, match=needed):
        restore_backup(backup, tmp_path / "new")
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("name", ["catalog.sqlite3", ".restore-other"])
def test_what_comes_into_an_empty_folder_during_a_restore_is_not_replaced(
    backup, tmp_path, monkeypatch, name
):
    target, restore = tmp_path / "mount", storage.backup.restore._restore
    target.mkdir()

    def restore_beside_another(*arguments):
        (target / name).write_bytes(b"of another restore, or of a service")
        return restore(*arguments)

    monkeypatch.setattr(storage.backup.restore, "_restore", restore_beside_another)
    with pytest.raises(InvalidParameters, match=f"'{name}' is there meanwhile"):
        restore_backup(backup, target)
    assert [path.name for path in target.iterdir()] == [name]
    assert (target / name).read_bytes() == b"of another restore, or of a service"


def test_each_file_and_folder_that_is_restored_is_on_disk(backup, tmp_path, monkeypatch):
    synced = set()
    fsync = os.fsync

    def spy(descriptor):
        synced.add(os.fstat(descriptor).st_ino)
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", spy)
    restore_backup(backup, tmp_path / "new")
    paths = [tmp_path, tmp_path / "new", *(tmp_path / "new").rglob("*")]
    assert [path for path in paths if path.stat().st_ino not in synced] == []


@pytest.mark.parametrize("fault", [FileNotFoundError, PermissionError])
def test_a_backup_that_cannot_be_opened_is_named_and_nothing_is_made(
    backup, tmp_path, monkeypatch, fault
):
    opened = Path.open

    def refuse(path, *arguments, **options):
        if path == backup:
            raise fault(errno.EACCES, "refused", str(path))
        return opened(path, *arguments, **options)

    monkeypatch.setattr(Path, "open", refuse)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(fault) as refused:
        restore_backup(backup, tmp_path / "disk" / "new")
    assert refused.value.filename == str(backup)
    assert sorted(tmp_path.iterdir()) == before


def test_a_truncated_backup_is_rejected(backup, tmp_path):
    whole = backup.read_bytes()
    with tarfile.open(backup) as tar:
        last = tar.getmembers()[-1]
    end = last.offset_data + last.size  # what follows is padding
    for share in (0.0, 0.1, 0.5, 0.9, 0.97):
        backup.write_bytes(whole[: int(share * end)])
        require_rejected(backup, tmp_path)


def test_a_backup_with_a_changed_byte_is_rejected(backup, tmp_path):
    content = members(backup)
    for number, (member, body) in enumerate(content):
        changed = bytearray(body)
        changed[len(body) // 2] ^= 1
        rewrite(backup, [*content[:number], (member, bytes(changed)), *content[number + 1 :]])
        require_rejected(backup, tmp_path)


def test_a_backup_without_one_of_its_files_is_rejected(backup, tmp_path):
    content = members(backup)
    for number in range(len(content)):
        rewrite(backup, content[:number] + content[number + 1 :])
        require_rejected(backup, tmp_path)


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
def test_a_name_outside_of_the_folder_is_rejected(backup, tmp_path, name):
    content = [(tarfile.TarInfo(name), b"evil"), *members(backup)]
    rewrite(backup, content)
    require_rejected(backup, tmp_path, "cannot be part")
    assert not (tmp_path / "outside").exists()


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.FIFOTYPE])
def test_links_and_devices_in_a_backup_are_rejected(backup, tmp_path, kind):
    content = members(backup)
    link = tarfile.TarInfo("store-id")
    link.type, link.linkname = kind, "/etc/passwd"
    rewrite(backup, [(link, b""), *content])
    require_rejected(backup, tmp_path, "cannot be part")


def test_a_sparse_file_in_a_backup_is_rejected_before_its_gaps_are_written(backup, tmp_path):
    content = members(backup)
    sparse = tarfile.TarInfo("store-id")
    sparse.pax_headers = {"GNU.sparse.size": str(2**20), "GNU.sparse.map": "0,1"}
    rewrite(backup, [(sparse, b"x"), *content])
    require_rejected(backup, tmp_path, "cannot be part")


def test_a_file_twice_in_a_backup_is_rejected(backup, tmp_path):
    content = members(backup)
    rewrite(backup, [content[0], *content])
    require_rejected(backup, tmp_path, "twice")


def test_a_catalog_that_names_more_than_the_manifest_is_rejected(backup, tmp_path):
    content = members(backup)
    manifest = json.loads(content[-1][1])
    path = next(name for name in manifest["files"] if "chunks" in name)
    del manifest["files"][path]
    rewrite(backup, [*content[:-1], (content[-1][0], json.dumps(manifest).encode())])
    require_rejected(backup, tmp_path, "lacks maps/")


def with_manifest(backup, change, **bodies):
    """Rewrite a backup with other files, of which its manifest is right, and a changed manifest."""
    content = [(member, bodies.get(member.name, body)) for member, body in members(backup)]
    manifest = json.loads(content[-1][1])
    for name, body in bodies.items():
        facts = {"size": len(body), "sha256": hashlib.sha256(body).hexdigest()}
        manifest["files"][name] = facts
    change(manifest)
    rewrite(backup, [*content[:-1], (content[-1][0], json.dumps(manifest).encode())])


def test_a_backup_with_the_id_of_another_store_is_rejected(backup, tmp_path):
    with_manifest(backup, dict, **{"store-id": b"0" * 32 + b"\n"})
    require_rejected(backup, tmp_path, "store-id is not its catalog's")


@pytest.mark.parametrize(
    ("part", "value"), [("format", "another-backup"), ("format_version", 2), ("format_version", 0)]
)
def test_a_backup_of_another_format_or_version_is_rejected_and_named(backup, tmp_path, part, value):
    with_manifest(backup, lambda manifest: manifest.update({part: value}))
    require_rejected(backup, tmp_path, f"the backup is a .*{value}.*, wanted ")


@pytest.mark.parametrize("name", ["catalog.sqlite3", "store-id"])
def test_a_manifest_without_the_catalog_or_the_id_of_the_store_is_rejected(backup, tmp_path, name):
    with_manifest(backup, lambda manifest: manifest["files"].pop(name))
    require_rejected(backup, tmp_path, f"manifest lacks {name}")
