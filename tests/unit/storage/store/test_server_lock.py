"""The data directory of a server: it stays that one, also if it or its catalog is replaced."""

import errno
import fcntl
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from storage.backup.backup import write_backup
from storage.backup.restore import restore_backup
from storage.catalog import NewCapture, RevisionFacts
from storage.errors import CorruptFile, DataDirInUse, StorageUnavailable
from storage.files.checker import Checker
from storage.store import Store
from storage.store.inventory import Inventory
from storage.store.server_lock import ServerLock
from tests.support.backups import scan_of

REPLACED = "the data directory was moved or replaced"
CATALOG_REPLACED = "the catalog's file was moved or replaced"
UNMOUNTED = "the folder of the maps was moved, replaced or unmounted"


@pytest.fixture
def serving(tmp_path):
    with Store.serving(tmp_path / "data") as store:
        store.maps.create("campus")
        store.drives.put_scan("campus", "monday", 0, scan_of(0))
        yield store


def test_a_server_keeps_its_lock_after_a_command_that_needs_it(serving):
    with serving.owned():
        pass
    with pytest.raises(DataDirInUse):
        ServerLock(serving.layout.lock).take()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")
def test_a_lock_that_root_makes_belongs_to_the_owner_of_the_folder(tmp_path):
    folder = tmp_path / "data"
    folder.mkdir()
    os.chown(folder, 12345, 23456)
    with ServerLock(folder / "server.lock").held():
        pass
    made = (folder / "server.lock").stat()
    assert (made.st_uid, made.st_gid) == (12345, 23456)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")
@pytest.mark.parametrize("link", [os.symlink, os.link])
def test_no_file_of_roots_is_given_away_that_a_lock_leads_to(tmp_path, link):
    (tmp_path / "data").mkdir()
    os.chown(tmp_path / "data", 65534, 65534)
    (tmp_path / "secret").write_text("of root's\n")
    link(tmp_path / "secret", tmp_path / "data/server.lock")
    lock = ServerLock(tmp_path / "data/server.lock")
    lock.take()
    lock.release()
    assert (tmp_path / "secret").stat().st_uid == 0


def test_a_file_system_without_locks_is_named_and_no_file_stays_open(tmp_path, monkeypatch):
    def flock(descriptor, operation):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", flock)
    before = len([*Path("/proc/self/fd").iterdir()])
    for _ in range(3):
        with pytest.raises(StorageUnavailable, match="cannot lock files: No locks available"):
            ServerLock(tmp_path / "server.lock").take()
    assert len([*Path("/proc/self/fd").iterdir()]) == before


def test_no_write_is_acknowledged_while_another_folder_is_in_the_place_of_the_data(
    serving, tmp_path
):
    write_backup(tmp_path / "data", tmp_path / "b.tar")
    restore_backup(tmp_path / "b.tar", tmp_path / "restored")
    (tmp_path / "data").rename(tmp_path / "old")
    (tmp_path / "restored").rename(tmp_path / "data")
    with pytest.raises(StorageUnavailable, match=f"{REPLACED} while the service runs: stop it"):
        serving.drives.put_scan("campus", "monday", 1, scan_of(1))
    with pytest.raises(StorageUnavailable, match=REPLACED):
        serving.maps.delete("campus")
    assert serving.lacking() == [REPLACED]
    (tmp_path / "data").rename(tmp_path / "restored")
    (tmp_path / "old").rename(tmp_path / "data")
    serving.drives.put_scan("campus", "monday", 1, scan_of(1))
    assert serving.lacking() == []
    assert serving.drives.get("campus", "monday").scans == 2


def test_no_write_is_acknowledged_while_the_data_directory_is_gone(serving, tmp_path):
    (tmp_path / "data").rename(tmp_path / "old")
    with pytest.raises(StorageUnavailable, match=REPLACED):
        serving.maps.create("harbour")
    with pytest.raises(StorageUnavailable, match=REPLACED):
        serving.drives.put_scan("campus", "monday", 1, scan_of(1))
    assert serving.lacking() == [REPLACED]


def test_the_restored_folder_in_the_place_of_the_data_is_as_it_was(serving, tmp_path):
    write_backup(tmp_path / "data", tmp_path / "b.tar")
    restore_backup(tmp_path / "b.tar", tmp_path / "restored")
    (tmp_path / "data").rename(tmp_path / "old")
    (tmp_path / "restored").rename(tmp_path / "data")
    with pytest.raises(StorageUnavailable):
        serving.drives.put_scan("campus", "monday", 1, scan_of(1))
    with Store.serving(tmp_path / "data") as restored:
        assert restored.drives.get("campus", "monday").scans == 1


def test_a_scan_is_not_damaged_because_the_data_directory_is_gone(serving, tmp_path):
    inventory = Inventory(serving.catalog, serving.layout)
    [file] = inventory.files()
    (tmp_path / "data").rename(tmp_path / "old")
    with pytest.raises(StorageUnavailable, match=REPLACED):
        serving.drives.read_scan("campus", "monday", 0)
    with Checker() as checker, pytest.raises(StorageUnavailable, match=REPLACED):
        inventory.fault(file, checker)
    (tmp_path / "old").rename(tmp_path / "data")
    assert len(serving.drives.read_scan("campus", "monday", 0).points_m) > 0
    next((tmp_path / "data").rglob("chunks/*.h5")).unlink()
    with pytest.raises(CorruptFile, match="is gone"):
        serving.drives.read_scan("campus", "monday", 0)


@pytest.fixture
def on_another_disk(tmp_path):
    """A data directory whose maps are on another disk, the folder `disk`."""
    with Store.serving(tmp_path / "data") as store:
        store.maps.create("campus")
        store.drives.put_scan("campus", "monday", 0, scan_of(0))
    (tmp_path / "data/maps").rename(tmp_path / "disk")
    (tmp_path / "data/maps").symlink_to(tmp_path / "disk")
    return tmp_path / "data"


def unmount(tmp_path, *, mount_point):
    (tmp_path / "disk").rename(tmp_path / "unmounted")
    if mount_point:
        (tmp_path / "disk").mkdir(0o700)


def mount(tmp_path):
    if (tmp_path / "disk").exists():
        (tmp_path / "disk").rmdir()  # nothing was left in it
    (tmp_path / "unmounted").rename(tmp_path / "disk")


@pytest.mark.parametrize("mount_point", [True, False])
def test_no_write_is_acknowledged_while_the_disk_of_the_maps_is_not_mounted(
    on_another_disk, tmp_path, mount_point
):
    capture = NewCapture(drive="bags", files=(("a.bag", 32),), part_bytes=16)
    facts = RevisionFacts(encoding="harmonic", scans=1, segments=1, parameters={})
    with Store.serving(on_another_disk) as serving:
        begun, _ = serving.captures.create("campus", capture)
        map_id = serving.maps.get("campus").id
        unmount(tmp_path, mount_point=mount_point)
        for write in (
            lambda: serving.drives.put_scan("campus", "monday", 0, scan_of(0)),
            lambda: serving.drives.put_scan("campus", "monday", 1, scan_of(1)),
            lambda: serving.captures.create("campus", replace(capture, drive="tuesday")),
            lambda: serving.captures.put_part("campus", "bags", begun.id, 0, b"a" * 16),
            lambda: serving.revisions.add(map_id, "a" * 64, lambda path: path.touch(), facts),
            lambda: serving.drives.read_scan("campus", "monday", 0),
        ):
            with pytest.raises(StorageUnavailable, match=UNMOUNTED):
                write()
        assert serving.lacking() == [UNMOUNTED]
        shutil.rmtree(tmp_path / "disk", ignore_errors=True)
        mount(tmp_path)
        assert serving.lacking() == []
        assert len(serving.drives.read_scan("campus", "monday", 0).points_m) > 0
        serving.drives.put_scan("campus", "monday", 1, scan_of(1))


def test_a_server_does_not_start_while_the_disk_of_its_maps_is_not_mounted(
    on_another_disk, tmp_path
):
    unmount(tmp_path, mount_point=True)
    with pytest.raises(StorageUnavailable, match="maps is empty, and the catalog names files in"):
        Store.serving(on_another_disk)
    mount(tmp_path)
    with Store.serving(on_another_disk) as serving:
        assert len(serving.drives.read_scan("campus", "monday", 0).points_m) > 0


def test_a_server_starts_without_its_files_where_a_folder_says_that_they_are_lost(
    on_another_disk, tmp_path
):
    unmount(tmp_path, mount_point=True)
    with pytest.raises(StorageUnavailable) as refused:
        Store.serving(on_another_disk)
    _, _, folder = str(refused.value).rpartition("make the folder ")
    Path(folder).mkdir()
    for _ in range(2):
        with Store.serving(on_another_disk) as serving, pytest.raises(CorruptFile, match="gone"):
            serving.drives.read_scan("campus", "monday", 0)


def test_a_process_that_holds_the_folders_stores_nothing_while_the_disk_is_not_mounted(
    on_another_disk, tmp_path
):
    with Store(on_another_disk) as of_a_job:
        for _ in range(2):
            of_a_job.hold()
        unmount(tmp_path, mount_point=True)
        with pytest.raises(StorageUnavailable, match=UNMOUNTED):
            of_a_job.drives.put_scan("campus", "monday", 1, scan_of(1))


@pytest.mark.parametrize("url", [None, "sqlite:///{}/elsewhere.sqlite3"])
@pytest.mark.parametrize("is_replaced", [True, False])
def test_no_write_is_acknowledged_while_the_catalogs_file_is_another_or_gone(
    url, is_replaced, tmp_path
):
    catalog_url = url and url.format(tmp_path)
    with Store.serving(tmp_path / "data", catalog_url) as serving:
        serving.maps.create("campus")
        at = tmp_path / ("elsewhere.sqlite3" if url else "data/catalog.sqlite3")
        kept = at.with_name("kept")
        at.rename(kept)
        if is_replaced:  # as rsync does with a backup
            at.write_bytes(kept.read_bytes())
        with pytest.raises(StorageUnavailable, match=f"{CATALOG_REPLACED} while the service runs"):
            serving.maps.create("harbour")
        assert serving.lacking() == [CATALOG_REPLACED]
        kept.replace(at)
        serving.maps.create("harbour")
        assert serving.lacking() == []
