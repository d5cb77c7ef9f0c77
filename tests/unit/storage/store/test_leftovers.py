"""What a start reads to find what no row names, and what it does with that."""

import errno
import os
from pathlib import Path

import pytest

from storage.errors import StorageFull
from storage.store import Store, leftovers
from tests.support.catalog_queries import catalog_queries
from tests.support.small_scans import sample_scan


def queries_of_a_start(store: Store) -> int:
    with catalog_queries(store) as queries:
        store.recover()
    return len(queries)


def test_a_start_makes_as_many_queries_of_many_maps_and_drives_as_of_one(store):
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
