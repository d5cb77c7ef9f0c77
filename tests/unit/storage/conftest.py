"""A store with one map."""

import shutil

import pytest

from storage.store import Store


@pytest.fixture(scope="session")
def data_dir_with_a_map(tmp_path_factory):
    folder = tmp_path_factory.mktemp("store") / "data"
    with Store(folder) as made:
        made.maps.create("campus")
    return folder


@pytest.fixture
def store(tmp_path, data_dir_with_a_map):
    # Copied, because to run the migrations takes 0.1 s.
    shutil.copytree(data_dir_with_a_map, tmp_path / "data")
    with Store(tmp_path / "data") as opened:
        yield opened
