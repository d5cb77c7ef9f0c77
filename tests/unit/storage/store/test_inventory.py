"""The files that the catalog names: all, or one by its path."""

import pytest

from storage.catalog import scans
from storage.store.inventory import Inventory
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
