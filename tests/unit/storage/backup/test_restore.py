"""Restores: whole or not at all."""

import json
import tarfile

import pytest

from core.errors import InvalidParameters
from storage.backup.restore import restore_backup
from storage.errors import CorruptFile
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


def test_a_restore_rejects_a_folder_that_is_not_empty(backup, tmp_path):
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
