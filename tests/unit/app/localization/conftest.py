"""A store with maps of one shared basis."""

import pytest

from storage.store import Store
from tests.support.indexed_maps import MAPS, SCANS, add, map_of
from tests.support.new_catalog import put_new_catalog
from tests.support.samples import sample_harmonic_map


@pytest.fixture(scope="module")
def maps():
    like, _ = sample_harmonic_map(SCANS)
    basis = like.basis()
    return basis, {f"d{n:02}": map_of(basis, like, n) for n in range(MAPS + 2)}


@pytest.fixture
def store(maps, tmp_path):
    basis, of_slug = maps
    (tmp_path / "data").mkdir()
    put_new_catalog(tmp_path / "data/catalog.sqlite3")
    with_maps = Store(tmp_path / "data")
    with_maps.bases.add("city", basis)
    for slug in list(of_slug)[:MAPS]:
        add(with_maps, slug, of_slug[slug])
    yield with_maps
    with_maps.close()
