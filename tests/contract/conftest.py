"""A catalog on every database that it supports."""

import pytest

from storage.catalog import Catalog


@pytest.fixture
def catalog(database_url):
    opened = Catalog(database_url)
    yield opened
    opened.close()
