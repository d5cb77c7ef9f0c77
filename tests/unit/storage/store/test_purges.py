"""Purges of a store: files go after all rows, and what was interrupted goes on."""

import logging
import shutil

import pytest

from storage.backup.backup import write_backup
from storage.backup.restore import restore_backup
from storage.errors import StorageBusy
from storage.store import Store
from storage.store.verification import verify
from tests.support.small_scans import sample_scan

FILES = 6


@pytest.fixture
def filled(store):
    """A store with a drive of several files, each of several scans."""
    for first in range(0, 3 * FILES, 3):
        scans = [(index, sample_scan(index)) for index in range(first, first + 3)]
        store.drives.put_scans("campus", "monday", scans)
    return store


def interrupt(store: Store, what: str, rows: int) -> None:
    """Begin a purge of the map or its drive and end after a batch, as a crash does."""
    if what == "map":
        store.catalog.recycle_bin.put_map("campus", purging=True)
    else:
        store.catalog.recycle_bin.put_drive("campus", "monday", purging=True)
    [purge] = store.catalog.purges.begun()
    store.catalog.purges.remove_some(purge, rows=rows)


def chunks(store: Store) -> int:
    return len([*store.layout.maps.rglob("chunks/*.h5")])


@pytest.mark.parametrize("what", ["map", "drive"])
@pytest.mark.parametrize("rows", [4, 1000])
def test_a_start_leaves_the_files_of_a_half_purged_drive_to_the_collector(filled, what, rows):
    data = filled.layout.data_dir
    interrupt(filled, what, rows)
    assert verify(filled).findings == ()
    filled.close()
    with Store.serving(data) as again:
        assert chunks(again) == FILES
        assert not again.layout.orphans.exists()
        assert verify(again, repair=True).findings == ()
        again.purges.finish_all()
        assert chunks(again) == 0
        assert again.catalog.purges.begun() == []
        assert verify(again).findings == ()
        assert again.catalog.scans.chunks_by_drive() == {}


@pytest.mark.parametrize("what", ["map", "drive"])
def test_a_purge_that_lost_its_files_before_a_crash_ends_after_the_next_start(filled, what):
    interrupt(filled, what, 1000)
    shutil.rmtree(filled.layout.maps)
    filled.layout.maps.mkdir()
    filled.close()
    with Store.serving(filled.layout.data_dir) as again:
        again.purges.finish_all()
        assert again.catalog.purges.begun() == []
        assert len(again.maps.list().items) == (what == "drive")


def test_files_are_removed_after_the_rows_that_name_them_and_before_the_purge_has_ended(
    filled, monkeypatch
):
    removed = []

    def rmtree(path, **_):
        removed.append(path)
        assert len(filled.catalog.purges.begun()) == 1  # or a crash now leaves them to `orphans/`
        assert filled.catalog.scans.chunks_by_drive() == {}
        assert chunks(filled) == FILES

    monkeypatch.setattr(shutil, "rmtree", rmtree)
    filled.drives.purge("campus", "monday")
    assert len(removed) == 1


def test_what_a_busy_database_leaves_of_a_purge_is_removed_later(filled, monkeypatch, caplog):
    end = filled.catalog.purges.end

    def busy(_):
        raise StorageBusy("another process writes")

    monkeypatch.setattr(filled.catalog.purges, "end", busy)
    filled.maps.purge("campus")
    assert "what is left of the purged map" in caplog.text
    assert "another process writes" in caplog.text
    assert filled.maps.list().items == filled.recycle_bin.list().items == ()
    monkeypatch.setattr(filled.catalog.purges, "end", end)
    filled.purges.finish_all()
    assert filled.catalog.purges.begun() == []


@pytest.mark.parametrize("of", ["a request", "the collector"])
@pytest.mark.parametrize("what", ["map", "drive"])
def test_a_stop_ends_a_purge_after_its_batch_and_the_next_start_goes_on(
    filled, monkeypatch, caplog, what, of
):
    remove_some, batches = filled.catalog.purges.remove_some, []

    def stopped_in_the_second(purge):
        batches.append(purge)
        if len(batches) == 2:
            filled.purges.stop()
        return remove_some(purge, rows=4)

    if of == "the collector":
        interrupt(filled, what, 4)
    monkeypatch.setattr(filled.catalog.purges, "remove_some", stopped_in_the_second)
    with caplog.at_level(logging.INFO, "tensormap.storage"):
        if of == "the collector":
            filled.purges.finish_all()
        elif what == "map":
            filled.maps.purge("campus")
        else:
            filled.drives.purge("campus", "monday")
    assert len(batches) == 2
    assert f"a stop interrupts the purge of {what}" in caplog.text
    assert chunks(filled) == FILES
    filled.purges.finish_all()  # begins none
    assert len(batches) == 2
    filled.close()
    with Store.serving(filled.layout.data_dir) as again:
        again.purges.finish_all()
        assert again.catalog.purges.begun() == []
        assert chunks(again) == 0


@pytest.mark.parametrize("what", ["map", "drive"])
def test_a_backup_of_a_half_purged_drive_is_restored_to_one_whose_purge_goes_on(
    filled, tmp_path, what
):
    interrupt(filled, what, 4)
    written = write_backup(filled.layout.data_dir, tmp_path / "b.tar")
    assert (written.damaged, written.missing) == ((), ())
    restore_backup(tmp_path / "b.tar", tmp_path / "new")
    with Store.serving(tmp_path / "new") as restored:
        assert verify(restored).findings == ()
        assert not restored.layout.orphans.exists()
        assert restored.recycle_bin.list().items == ()
        restored.purges.finish_all()
        assert restored.catalog.purges.begun() == []
        assert chunks(restored) == 0
        assert verify(restored).findings == ()
