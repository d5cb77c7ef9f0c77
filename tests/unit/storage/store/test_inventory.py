"""The files that the catalog names: all, or one by its path."""

import pytest

from storage.catalog import scans
from storage.files.checker import Checker
from storage.store.inventory import Inventory
from storage.store.verification import verify
from tests.support.catalog_queries import catalog_queries
from tests.support.small_scans import sample_scan


@pytest.fixture
def inventory(store):
    """Five scans, each in a file of its own, as a drive has them that is not closed."""
    for index in range(5):
        store.drives.put_scan("campus", "monday", index, sample_scan(index, 200))
    return Inventory(store.catalog, store.layout)


def test_a_file_is_found_by_its_path_as_it_is_among_all(inventory):
    assert [inventory.file(path) for path in inventory.paths()] == list(inventory.files())


def test_a_file_that_no_row_names_is_none(inventory):
    folder = inventory.paths()[0].rpartition("/")[0]
    assert inventory.file(f"{folder}/{'0' * 32}.h5") is None


def test_only_the_rows_of_its_scans_are_read_for_one_file(inventory, monkeypatch):
    read, record = [], scans._record

    def counted(*row):
        read.append(row)
        return record(*row)

    monkeypatch.setattr(scans, "_record", counted)
    assert inventory.file(inventory.paths()[3]) is not None
    assert len(read) == 1


def test_all_paths_are_listed_by_as_many_queries_as_those_of_one_drive(store, inventory):
    with catalog_queries(store) as before:
        inventory.paths()
    for drive in ("tuesday", "friday"):
        store.drives.put_scan("campus", drive, 0, sample_scan(0))
    with catalog_queries(store) as queries:
        assert len(inventory.paths()) == 7
    assert len(queries) == len(before)


def test_files_that_are_gone_are_found_without_reading_the_rows_of_their_drive_for_each(
    store, inventory, monkeypatch
):
    for path in inventory.paths():
        (store.layout.data_dir / path).unlink()
    with monkeypatch.context() as patch, catalog_queries(store) as queries:
        patch.setattr(store.catalog.scans, "of_chunk", None)
        found = verify(store).findings
    assert [finding.what for finding in found] == ["the file is gone"] * 5
    of_names = [query for query in queries if "recycle_bin.slug \nFROM" in query]
    assert len(of_names) == 1
    files = list(inventory.files())
    store.drives.purge("campus", "monday")
    with Checker() as checker:
        assert [inventory.fault(file, checker) for file in files] == [None] * 5
