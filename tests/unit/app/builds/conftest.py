"""A store with a map that has no drive yet."""

import pytest

from storage.store import Store
from tests.support.new_catalog import put_new_catalog


@pytest.fixture
def store(tmp_path):
    put_new_catalog(tmp_path / "catalog.sqlite3")
    with Store.serving(tmp_path) as opened:
        opened.maps.create("campus")
        yield opened
