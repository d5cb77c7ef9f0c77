"""What a start reads to find what no row names, and what it does with that."""

import errno
import os
import shutil
from pathlib import Path

import pytest

from storage.errors import StorageFull
from storage.files import files
from storage.store import Store, leftovers
from tests.support.catalog_queries import catalog_queries
from tests.support.small_scans import sample_scan


def queries_of_a_start(store: Store) -> int:
    with catalog_queries(store) as queries:
        store.recover()
    return len(queries)


def test_a_start_makes_as_many_queries_of_many_maps_and_drives_as_of_one(store):
    (store.layout.maps / "other").mkdir()  # an empty folder takes a query of its own
    before = queries_of_a_start(store)
    for index in range(10):
        store.maps.create(f"yard-{index}")
        store.drives.put_scan(f"yard-{index}", "monday", 0, sample_scan(0))
    assert queries_of_a_start(store) == before


@pytest.mark.parametrize("fault", ["of another user", "the disk is full"])
def test_what_cannot_be_moved_is_left_and_copied_nowhere_and_the_service_starts(
    store, monkeypatch, caplog, fault
):
    data_dir = store.layout.data_dir
    left = [store.layout.maps / "copied", store.layout.orphans / "copied"]  # of an older version
    for folder in left:
        folder.mkdir(parents=True)
        (folder / "x.h5").write_bytes(b"only copy")
    store.close()

    def refused(name):
        original = getattr(os, name)

        def call(path, *arguments, **options):
            if Path(path).name in {"copied", "x.h5"}:
                raise PermissionError(errno.EACCES, "Permission denied", str(path))
            return original(path, *arguments, **options)

        return call

    def full(path):
        raise StorageFull("no space is left")

    if fault == "the disk is full":
        monkeypatch.setattr(leftovers, "make_folder", full)
    else:  # a folder of root's cannot be moved, nor what is in it be removed
        monkeypatch.setattr(os, "rename", refused("rename"))
        monkeypatch.setattr(os, "unlink", refused("unlink"))
    for _ in range(2):
        with Store.serving(data_dir) as started:
            assert started.maps.list().items
    assert sorted(path.parent for path in data_dir.rglob("x.h5")) == sorted(left)
    warned = [record.getMessage().partition(" cannot be moved to ")[0] for record in caplog.records]
    assert warned == [*map(str, left)] * 2


@pytest.fixture
def on_another_disk(store, monkeypatch):
    """A folder that no row names, which is on another disk than `orphans/`."""
    folder = store.layout.maps / "0123abcd/drives"
    folder.mkdir(parents=True)
    (folder / "x.h5").write_bytes(b"only copy")
    store.close()
    original = os.rename

    def rename(path, *arguments, **options):
        if Path(path).name == folder.parent.name:
            raise OSError(errno.EXDEV, "Invalid cross-device link", str(path))
        return original(path, *arguments, **options)

    monkeypatch.setattr(os, "rename", rename)
    return folder / "x.h5"


def test_the_copy_of_an_orphan_on_another_disk_is_synced_before_the_orphan_is_removed(
    store, monkeypatch, on_another_disk
):
    synced = []

    def sync(path):
        if on_another_disk.exists():
            synced.append(path.name)
        files.sync(path)

    monkeypatch.setattr(leftovers, "sync", sync)
    with Store.serving(store.layout.data_dir):
        pass
    [copy] = store.layout.data_dir.rglob("x.h5")
    assert store.layout.orphans in copy.parents
    assert copy.read_bytes() == b"only copy"
    assert sorted(synced) == ["0123abcd", "drives", "maps", "x.h5"]


def test_an_orphan_that_cannot_be_copied_to_another_disk_stays_where_it_is(
    store, monkeypatch, on_another_disk
):
    def full(path):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(leftovers, "sync", full)
    with Store.serving(store.layout.data_dir):
        pass
    assert list(store.layout.data_dir.rglob("x.h5")) == [on_another_disk]


def test_a_link_that_no_row_names_is_moved_to_another_disk_as_a_link(store, on_another_disk):
    target = store.layout.data_dir.parent / "third disk"
    target.mkdir()
    (target / "x.h5").write_bytes(b"not ours")
    folder = on_another_disk.parent.parent
    shutil.rmtree(folder)
    folder.symlink_to(target)
    for _ in range(2):
        with Store.serving(store.layout.data_dir):
            pass
    [moved] = store.layout.orphans.rglob(folder.name)
    assert moved.readlink() == target
    assert not folder.is_symlink()
    assert (target / "x.h5").exists()


def test_an_orphan_with_a_link_that_leads_nowhere_is_copied_to_another_disk(store, on_another_disk):
    (on_another_disk.parent / "link").symlink_to("nowhere")
    with Store.serving(store.layout.data_dir):
        pass
    assert not on_another_disk.parent.exists()
    [link] = [path for path in store.layout.orphans.rglob("*") if path.is_symlink()]
    assert str(link.readlink()) == "nowhere"
