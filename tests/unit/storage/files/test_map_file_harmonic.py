"""Map files of the harmonic encoding."""

import json

import h5py
import numpy as np
import pytest

from core.scans.sensor import AngularGrid
from storage.errors import CorruptFile
from storage.files.map_file import read_map
from tests.support.map_files import replaced, whole_or_rejected
from tests.support.samples import sample_harmonic_map


@pytest.fixture(scope="module")
def tensor_map():
    return sample_harmonic_map(count=12, segment_length=4, drives=2)[0]


ARRAYS = list(sample_harmonic_map(count=3, segment_length=3)[0].arrays())


@pytest.mark.parametrize("name", ARRAYS)
def test_an_array_of_a_harmonic_map_that_cannot_be_is_rejected(path, tensor_map, name):
    array = tensor_map.arrays()[name]
    kinds = [
        array.astype(np.float16),
        array.astype(np.complex128),
        *([array.astype(array.dtype.newbyteorder(">"))] if array.itemsize > 1 else []),
        np.zeros(array.shape, [("r", "<f4"), ("j", "<f4")]),
    ]
    for other in kinds:
        replaced(path, name, other)
        with pytest.raises(CorruptFile, match=name):
            read_map(path)
    for other in (array[:0], array[:-1], array[None], np.repeat(array, 2, -1)):
        replaced(path, name, other)
        assert whole_or_rejected(path, "") is True
    replaced(path, name, None)
    with pytest.raises(CorruptFile, match=name):
        read_map(path)


@pytest.mark.parametrize("fill", [np.nan, np.inf, -1.0, 1e38])
def test_invalid_scales_of_renderings_are_rejected(path, tensor_map, fill):
    replaced(path, "rendering_scales", np.full_like(tensor_map.arrays()["rendering_scales"], fill))
    with pytest.raises(CorruptFile, match="rendering_scales"):
        read_map(path)


@pytest.mark.parametrize("name", ["azimuth_basis", "elevation_basis"])
def test_an_array_of_the_other_encoding_is_corrupt(path, name):
    with h5py.File(path, "r+") as file:
        file[name] = np.zeros((1, 2, 3), np.float32)
    with pytest.raises(CorruptFile, match=name):
        read_map(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("encoding", "paper"),
        ("image", "range"),
        ("image", None),
        ("distance", "other"),
        ("distance", None),
        ("lateral_renderings_m", None),
        ("lateral_renderings_m", []),
        ("lateral_renderings_m", [-1, 0, 1]),
        ("lateral_renderings_m", ["a"]),
        ("lateral_renderings_m", [float("nan"), 0, 1]),
        ("grid", {"rings": 6}),
        ("grid", {"rings": "6", "ring_m": 10.0, "azimuth_step_deg": 20.0}),
        ("grid", {"rings": 5, "ring_m": 10.0, "azimuth_step_deg": 20.0}),
        ("grid", AngularGrid(wraps=True).as_attributes()),
        ("reducer", "last"),
        ("ranks", [3, 11]),
    ],
)
def test_an_attribute_of_a_harmonic_map_that_cannot_be_is_rejected(path, tensor_map, name, value):
    with h5py.File(path, "r+") as file:
        file.attrs["attributes"] = json.dumps({**tensor_map.attributes(), name: value})
    with pytest.raises(CorruptFile):
        read_map(path)
