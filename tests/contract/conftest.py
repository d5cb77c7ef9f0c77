"""A catalog on every database that it can stand on."""

import pytest

from storage.catalog import Catalog


@pytest.fixture
def catalog(database_url):
    opened = Catalog(database_url)
    yield opened
    opened.close()
