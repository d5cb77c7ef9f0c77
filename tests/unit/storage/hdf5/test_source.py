"""Large arrays of bytes are pages of their file, small ones are copied."""

import os
from pathlib import Path

import numpy as np
import pytest

from storage.errors import CorruptFile
from storage.hdf5 import BytesSource, FileSource, Hdf5File
from storage.hdf5.dataset import ContiguousDataset
from storage.hdf5.writer import hdf5_in_memory

LARGE = np.random.default_rng(1).integers(-128, 128, (3, 2**19), np.int8)
SMALL = LARGE[:, :100]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "arrays.h5"
    path.write_bytes(hdf5_in_memory({"large": [LARGE], "small": [SMALL]}, {}))
    return path


def mapped(source, name):
    with Hdf5File(source) as file:
        dataset = file.dataset(name, contiguous=True)
        assert isinstance(dataset, ContiguousDataset)
        return dataset.mapped()


def mappings(path):
    """Return how many regions of this process are pages of a file."""
    return sum(str(path) in line for line in Path("/proc/self/maps").read_text().splitlines())


def test_a_large_array_is_pages_of_its_file_as_long_as_it_is_used(path):
    array = mapped(FileSource(path), "large")
    np.testing.assert_array_equal(array, LARGE)
    assert not array.flags.writeable
    assert mappings(path) == 1
    part = array[1:]
    del array
    np.testing.assert_array_equal(part, LARGE[1:])
    del part
    assert mappings(path) == 0


def test_a_small_array_and_one_of_bytes_in_memory_are_copied(path):
    np.testing.assert_array_equal(mapped(FileSource(path), "small"), SMALL)
    np.testing.assert_array_equal(mapped(BytesSource(path.read_bytes()), "large"), LARGE)
    assert mappings(path) == 0


def test_a_mapped_array_outlives_its_file_and_another_of_its_name(path):
    array = mapped(FileSource(path), "large")
    other = path.with_suffix(".new")
    other.write_bytes(hdf5_in_memory({"large": [LARGE // 2]}, {}))
    other.replace(path)
    np.testing.assert_array_equal(array, LARGE)
    path.unlink()
    np.testing.assert_array_equal(array, LARGE)


def test_what_cannot_be_read_is_an_error_before_it_is_mapped(path, monkeypatch):
    def failing(*args):
        raise OSError(5, "Input/output error")

    with Hdf5File(FileSource(path)) as file:
        dataset = file.dataset("large", contiguous=True)
        assert isinstance(dataset, ContiguousDataset)
        monkeypatch.setattr(os, "preadv", failing)
        with pytest.raises(CorruptFile, match="large cannot be read"):
            dataset.mapped()


def test_an_array_of_a_file_that_became_shorter_is_an_error(path):
    with Hdf5File(FileSource(path)) as file:
        dataset = file.dataset("large", contiguous=True)
        assert isinstance(dataset, ContiguousDataset)
        os.truncate(path, 2**20)
        with pytest.raises(CorruptFile, match="large is cut off"):
            dataset.mapped()


def test_a_read_that_returns_less_than_wanted_goes_on(path, monkeypatch):
    preadv = os.preadv  # of Linux at most 2 GB at once
    monkeypatch.setattr(
        os, "preadv", lambda of, buffers, at: preadv(of, [buffers[0][: 1 + at % 1000]], at)
    )
    with Hdf5File(FileSource(path)) as file:
        np.testing.assert_array_equal(file.dataset("small").read(), SMALL)
