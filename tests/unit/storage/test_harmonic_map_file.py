"""Map files of the harmonic encoding."""

import json

import h5py
import numpy as np
import pytest

from core.errors import InvalidMap
from core.sensor import AngularGrid
from storage.errors import CorruptFile
from storage.map_file import read_map, write_map
from tests.support.samples import sample_harmonic_map
from tests.unit.storage.test_map_file import replaced, whole_or_refused


@pytest.fixture(scope="module")
def harmonic_map():
    return sample_harmonic_map(count=12, segment_length=4, drives=2)[0]


@pytest.fixture
def harmonic_path(tmp_path, harmonic_map):
    write_map(tmp_path / "harmonic.h5", harmonic_map)
    return tmp_path / "harmonic.h5"


HARMONIC_ARRAYS = list(sample_harmonic_map(count=3, segment_length=3)[0].arrays())


def test_a_harmonic_map_comes_back_to_the_bit(harmonic_path, harmonic_map):
    again = read_map(harmonic_path)
    assert again.revision == harmonic_map.revision
    assert again.attributes() == harmonic_map.attributes()
    for name, array in harmonic_map.arrays().items():
        np.testing.assert_array_equal(again.arrays()[name], array)
        assert again.arrays()[name].dtype == array.dtype


def test_a_flipped_byte_in_any_array_of_a_harmonic_map_is_refused(harmonic_path, harmonic_map):
    content = harmonic_path.read_bytes()
    with h5py.File(harmonic_path) as file:
        spans = {name: (d.id.get_offset(), d.id.get_storage_size()) for name, d in file.items()}
    rng = np.random.default_rng(1)
    for name, (offset, size) in spans.items():
        for place in rng.integers(offset, offset + size, size=6).tolist():
            damaged = bytearray(content)
            damaged[place] ^= 1 << int(rng.integers(8))
            harmonic_path.write_bytes(damaged)
            assert whole_or_refused(harmonic_path, harmonic_map.revision), f"{name}, byte {place}"


@pytest.mark.parametrize("name", HARMONIC_ARRAYS)
def test_an_array_of_a_harmonic_map_that_cannot_be_is_refused(harmonic_path, harmonic_map, name):
    array = harmonic_map.arrays()[name]
    kinds = [
        np.abs(array).astype(np.float16),
        array.astype(np.complex128),
        array.astype(array.dtype.newbyteorder(">")),
        np.zeros(array.shape, [("r", "<f4"), ("j", "<f4")]),
    ]
    for other in kinds:
        replaced(harmonic_path, name, other)
        with pytest.raises(CorruptFile, match=name):
            read_map(harmonic_path)
    for other in (array[:0], array[:-1], array[None], np.repeat(array, 2, -1)):
        replaced(harmonic_path, name, other)
        assert whole_or_refused(harmonic_path, "") is True
    replaced(harmonic_path, name, None)
    with pytest.raises(CorruptFile, match=name):
        read_map(harmonic_path)


@pytest.mark.parametrize("fill", [np.nan, np.inf, 1j, 1e38])
def test_harmonic_signatures_of_nonsense_are_refused(harmonic_path, harmonic_map, fill):
    replaced(harmonic_path, "signatures", np.full_like(harmonic_map.arrays()["signatures"], fill))
    assert whole_or_refused(harmonic_path, "") is True


@pytest.mark.parametrize("name", ["azimuth_basis", "elevation_basis"])
def test_an_array_of_the_other_encoding_is_corrupt(harmonic_path, name):
    with h5py.File(harmonic_path, "r+") as file:
        file[name] = np.zeros((1, 2, 3), np.float32)
    with pytest.raises(CorruptFile, match=name):
        read_map(harmonic_path)


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
def test_an_attribute_of_a_harmonic_map_that_cannot_be_is_refused(
    harmonic_path, harmonic_map, name, value
):
    with h5py.File(harmonic_path, "r+") as file:
        file.attrs["attributes"] = json.dumps({**harmonic_map.attributes(), name: value})
    with pytest.raises((CorruptFile, InvalidMap)):
        read_map(harmonic_path)
