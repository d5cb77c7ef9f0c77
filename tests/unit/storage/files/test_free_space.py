"""What may be written on a disk of which a part is kept free."""

import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from core.scans.scan import Scan
from storage.errors import StorageFull
from storage.files.free_space import OF_SCANS, OF_UPLOADS, Reserve, has_inodes

RESERVE = Reserve(most_bytes=100, part=20, purpose="of tests")


@pytest.fixture
def disk(tmp_path, monkeypatch):
    """Return a function that sets the size of the disk, and how much of it is free."""

    def of(total, free):
        usage = shutil.disk_usage(tmp_path)._replace(total=total, free=free)
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)

    return of


@pytest.mark.parametrize(
    ("total", "kept"), [(1000, 50), (1999, 99), (2000, 100), (2019, 100), (10**9, 100)]
)
def test_a_part_of_a_small_disk_and_so_much_of_a_large_one_stays_free(disk, tmp_path, total, kept):
    disk(total, kept + 7)
    RESERVE.require(tmp_path, 7, "it")
    with pytest.raises(StorageFull):
        RESERVE.require(tmp_path, 8, "it")
    assert RESERVE.left_bytes(tmp_path) == 7


def test_the_error_has_what_is_needed_what_is_left_and_what_is_kept_for_what(disk, tmp_path):
    disk(1000, 60)
    needed = "^part 3 needs 11 bytes; the disk has 60 left, 50 are kept free of tests$"
    with pytest.raises(StorageFull, match=needed):
        RESERVE.require(tmp_path, 11, "part 3")


def test_nothing_may_be_written_on_a_disk_that_has_less_than_is_kept(disk, tmp_path):
    disk(1000, 49)
    assert RESERVE.left_bytes(tmp_path) == 0
    with pytest.raises(StorageFull):
        RESERVE.require(tmp_path, 0, "it")


def test_what_is_written_leaves_what_is_kept(disk, tmp_path):
    disk(1000, 50)
    RESERVE.require_kept(tmp_path, "it")
    disk(1000, 49)
    left = "^it would leave 49 bytes of the disk, 50 are kept free of tests$"
    with pytest.raises(StorageFull, match=left):
        RESERVE.require_kept(tmp_path, "it")


def test_scans_may_use_space_that_uploads_leave_and_leave_some_for_the_catalog(disk, tmp_path):
    total = 2**40
    disk(total, 2**30)
    with pytest.raises(StorageFull):
        OF_UPLOADS.require(tmp_path, 1, "an upload")
    OF_SCANS.require(tmp_path, 2**30 - 2**24, "a scan")
    with pytest.raises(StorageFull):
        OF_SCANS.require(tmp_path, 2**30 - 2**24 + 1, "a scan")


@pytest.mark.parametrize(
    ("inodes", "left", "fits"),
    [(65536, 1, True), (65536, 0, False), (0, 0, True)],  # the last as of btrfs, which counts none
)
def test_a_file_fits_where_an_inode_is_left_or_none_are_counted(
    inodes, left, fits, tmp_path, monkeypatch
):
    monkeypatch.setattr(os, "statvfs", lambda _: SimpleNamespace(f_files=inodes, f_favail=left))
    assert has_inodes(tmp_path) == fits


@pytest.fixture
def full_beside_maps(store, monkeypatch):
    """Let `maps/` be on a disk with room, and the rest of the data directory on a full one."""
    free = {store.layout.maps: 2**40, store.layout.data_dir: 0}
    usage = shutil.disk_usage(store.layout.data_dir)._replace(total=2**40)
    monkeypatch.setattr(
        shutil, "disk_usage", lambda path: usage._replace(free=free.get(Path(path), 2**40))
    )


@pytest.mark.usefixtures("full_beside_maps")
def test_scans_leave_space_for_the_catalog_where_maps_are_on_another_disk(store):
    scan = Scan.from_returns([[10.0, 0.0, 0.0]])
    with pytest.raises(StorageFull, match="more rows of scans would leave 0 bytes of the disk"):
        store.drives.put_scan("campus", "monday", 0, scan)
    assert not [path for path in store.layout.maps.rglob("*") if path.is_file()]


@pytest.mark.usefixtures("full_beside_maps")
def test_a_store_whose_catalogs_disk_is_full_says_so_where_maps_are_on_another(store):
    assert store.lacking() == ["the data directory has 0 bytes left for scans, one needs more"]


def test_a_store_whose_file_system_has_no_inode_left_says_so(store, monkeypatch):
    assert store.lacking() == []
    monkeypatch.setattr("storage.store.store.has_inodes", lambda _: False)
    assert store.lacking() == [
        "the data directory's file system has no inode left for another file: `df -i`"
    ]
