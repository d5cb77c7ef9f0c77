"""A store with maps of one shared basis."""

import shutil

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


@pytest.fixture(scope="module")
def data_dir_with_maps(maps, tmp_path_factory):
    basis, of_slug = maps
    folder = tmp_path_factory.mktemp("maps") / "data"
    folder.mkdir()
    put_new_catalog(folder / "catalog.sqlite3")
    with Store(folder) as made:
        made.bases.add("city", basis)
        for slug in list(of_slug)[:MAPS]:
            add(made, slug, of_slug[slug])
    return folder


@pytest.fixture
def store(tmp_path, data_dir_with_maps):
    # Copied, because to store the maps takes 0.15 s.
    shutil.copytree(data_dir_with_maps, tmp_path / "data")
    with Store(tmp_path / "data") as opened:
        yield opened
