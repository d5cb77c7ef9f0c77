"""A catalog on every database that it supports."""

from pathlib import Path

import pytest
from sqlalchemy import make_url

from storage.catalog import Catalog
from tests.support.new_catalog import put_new_catalog


@pytest.fixture
def catalog(database_url):
    url = make_url(database_url)
    if url.get_backend_name() == "sqlite":
        put_new_catalog(Path(str(url.database)))
    opened = Catalog(database_url)
    yield opened
    opened.close()
