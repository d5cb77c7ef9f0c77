"""A store with one map, and a file of a map."""

import shutil

import pytest

from storage.files.map_file import write_map
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


@pytest.fixture
def path(tmp_path, tensor_map):
    """A file of the map that the module is about."""
    write_map(tmp_path / "map.h5", tensor_map)
    return tmp_path / "map.h5"
