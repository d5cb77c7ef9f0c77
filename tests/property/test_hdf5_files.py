"""What h5py writes is read the same without the HDF5 library, and what we write is HDF5."""

import io

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from storage.errors import CorruptFile
from storage.hdf5 import BytesSource, Hdf5File, Hdf5Writer
from storage.hdf5.checksums import fletcher32
from storage.hdf5.kinds import CODES

NAMES = st.text(
    st.characters(codec="utf-8", exclude_characters="/.\0", exclude_categories=["Cs"]),
    min_size=1,
    max_size=30,
)
SHAPES = st.lists(st.integers(0, 7), min_size=1, max_size=4).map(tuple)
ARRAYS = st.dictionaries(NAMES, st.tuples(st.sampled_from(sorted(CODES)), SHAPES), max_size=24)
TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=5000)
ATTRIBUTES = st.dictionaries(NAMES, st.one_of(TEXTS, st.integers(-(2**63), 2**63 - 1)), max_size=6)


class Memory:
    """A sink in memory."""

    def __init__(self):
        self.content = bytearray()

    def write(self, at, content):
        self.content.extend(bytes(max(0, at - len(self.content))))
        self.content[at : at + len(content)] = content


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
def test_a_file_of_ours_is_read_by_h5py_and_by_us(described, attributes):
    arrays, sink = numbers(described), Memory()
    writer = Hdf5Writer(sink)
    for name, array in arrays.items():
        writer.add(name, array.dtype.str, array.shape, [array[:2], array[2:]])
    writer.finish(attributes)
    content = bytes(sink.content)
    require_same(content, arrays, attributes)
    with h5py.File(io.BytesIO(content)) as file:
        assert set(file) == arrays.keys()
        for name, array in arrays.items():
            again = file[name][()]
            assert (again.dtype, again.tobytes()) == (array.dtype, array.tobytes())
        assert dict(file.attrs) == attributes


@pytest.mark.parametrize("rows", [1, 2, 3, 3071, 3072, 3073, 3076, 9000])
def test_chunks_are_listed_on_one_page_or_many_and_read_by_both(rows):
    """Three rows in a chunk, 1,024 chunks on a page of their list."""
    array = np.arange(rows * 2, dtype="<f4").reshape(rows, 2)
    sink, buffer = Memory(), io.BytesIO()
    writer = Hdf5Writer(sink)
    cells = writer.chunked("a", "<f4", (3, 2))
    for row, values in enumerate(array):
        cells[row] = values
    cells.end()
    writer.finish({})
    with h5py.File(io.BytesIO(bytes(sink.content))) as file:
        assert (file["a"][()] == array).all()
        assert (file["a"].chunks, file["a"].fletcher32) == ((3, 2), True)
    with h5py.File(buffer, "w", libver="v110") as file:
        made = file.create_dataset(
            "a",
            shape=(rows + 4, 2),
            maxshape=(rows + 4, 2),
            chunks=(3, 2),
            dtype="<f4",
            fletcher32=True,
        )
        made[:rows] = array
        made.resize(rows, axis=0)
    for content in (bytes(sink.content), buffer.getvalue()):
        dataset = Hdf5File(BytesSource(content)).dataset("a")
        assert (dataset.read() == array).all()
        for start, stop in ((0, 0), (1, 2), (2, 7), (rows - 2, rows + 9), (rows, rows)):
            assert (dataset.rows(start, stop) == array[max(0, start) : stop]).all()


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
