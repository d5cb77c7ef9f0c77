"""What h5py writes is read the same without the HDF5 library."""

import io
import tempfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from storage.errors import CorruptFile
from storage.hdf5 import BytesSource, FileSource, Hdf5File
from storage.hdf5.checksums import fletcher32
from storage.hdf5.kinds import CODES
from storage.hdf5.writer import hdf5_in_memory, hdf5_on_disk

pytestmark = pytest.mark.slow

NAMES = st.text(
    st.characters(codec="utf-8", exclude_characters="/.\0", exclude_categories=["Cs"]),
    min_size=1,
    max_size=30,
)
SHAPES = st.lists(st.integers(0, 7), min_size=1, max_size=4).map(tuple)
ARRAYS = st.dictionaries(NAMES, st.tuples(st.sampled_from(sorted(CODES)), SHAPES), max_size=24)
TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=5000)
ATTRIBUTES = st.dictionaries(NAMES, st.one_of(TEXTS, st.integers(-(2**63), 2**63 - 1)), max_size=6)


def numbers(described):
    rng = np.random.default_rng(0)
    return {
        name: (rng.integers(-100, 100, size=shape) / 4).astype(dtype)
        for name, (dtype, shape) in described.items()
    }


def require_same(content, arrays, attributes):
    file = Hdf5File(BytesSource(content))
    assert file.names == arrays.keys()
    for name, array in arrays.items():
        again = file.dataset(name).read()
        assert (again.dtype, again.shape) == (array.dtype, array.shape)
        assert again.tobytes() == array.tobytes()
    for name, value in attributes.items():
        if isinstance(value, str):
            assert file.attributes.text(name, 20_000) == value
        else:
            assert file.attributes.whole(name) == value


@settings(deadline=None)
@given(ARRAYS, ATTRIBUTES, st.sampled_from([None, "v108", "v110", "v112", "latest"]))
def test_a_file_of_h5py_is_read_as_h5py_reads_it(described, attributes, libver):
    arrays, buffer = numbers(described), io.BytesIO()
    with h5py.File(buffer, "w", libver=libver) as file:
        for name, array in arrays.items():
            file[name] = array
        for name, value in attributes.items():
            file.attrs[name] = value
    require_same(buffer.getvalue(), arrays, attributes)


@settings(deadline=None)
@given(ARRAYS, ATTRIBUTES)
def test_a_file_in_memory_holds_the_pieces_of_each_array(described, attributes):
    arrays = numbers(described)
    pieces = {name: [array[:2], array[2:]] for name, array in arrays.items()}
    require_same(bytes(hdf5_in_memory(pieces, attributes)), arrays, attributes)


@settings(deadline=None)
@given(ARRAYS, ATTRIBUTES)
def test_a_file_on_disk_holds_each_array_with_checksums(described, attributes):
    arrays = numbers(described)
    with tempfile.TemporaryDirectory() as folder:
        with hdf5_on_disk(Path(folder, "a.h5")) as writer:
            for name, array in arrays.items():
                writer.add(name, array)
            writer.add_attributes(attributes)
        require_same(Path(folder, "a.h5").read_bytes(), arrays, attributes)


@pytest.mark.parametrize("rows", [1, 2, 3, 2047, 2048, 2049, 2051, 4100])
@pytest.mark.parametrize("more", [0, 4])
def test_chunks_are_listed_on_one_page_or_many(tmp_path, rows, more):
    """Two rows in a chunk, 1,024 chunks on a page of their list."""
    array = np.arange(rows * 2, dtype="<f4").reshape(rows, 2)
    with hdf5_on_disk(tmp_path / "a.h5") as writer:
        cells = writer.add_rows("a", "<f4", rows + more, (min(2, rows + more), 2))
        for row, values in enumerate(array):
            cells[row] = values
        cells.end()
        with cells.readable() as open_still:
            assert (open_still.read() == array).all()
    with Hdf5File(FileSource(tmp_path / "a.h5")) as file:
        dataset = file.dataset("a")
        for start, stop in ((0, 0), (1, 2), (2, 7), (rows - 2, rows + 9), (rows, rows)):
            assert (dataset.rows(start, stop) == array[max(0, start) : stop]).all()
        assert dataset.rows(0, rows + 9).shape == (rows, 2)


@settings(deadline=None)
@given(st.binary(min_size=1, max_size=3000))
def test_the_checksum_of_a_chunk_is_that_of_hdf5(content):
    require_checksum_of_hdf5(content)


def require_checksum_of_hdf5(content):
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver="v110") as file:
        data = np.frombuffer(content, np.uint8)
        made = file.create_dataset("a", data=data, chunks=data.shape, fletcher32=True)
        place = made.id.get_chunk_info(0)
    whole = buffer.getvalue()
    stored = whole[place.byte_offset + len(content) : place.byte_offset + place.size]
    assert fletcher32(content) == int.from_bytes(stored, "little")


@pytest.mark.parametrize("fill", [0, 255])
def test_sums_that_are_a_multiple_of_65535_have_the_checksum_of_hdf5(fill):
    content = bytes([fill]) * 70_000
    require_checksum_of_hdf5(content)


@settings(deadline=None)
@given(st.binary(max_size=4000))
def test_bytes_of_any_kind_are_a_file_or_the_named_error(content):
    for begin in (b"", b"\x89HDF\r\n\x1a\n\0", b"\x89HDF\r\n\x1a\n\3"):
        with pytest.raises(CorruptFile):
            Hdf5File(BytesSource(begin + content))
