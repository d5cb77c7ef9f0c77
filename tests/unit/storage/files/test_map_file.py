"""A map file is read whole or not at all, whatever came to it."""

import json
from datetime import UTC, datetime

import h5py
import numpy as np
import pytest

import storage.hdf5.dataset
from core.errors import InvalidParameters
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.revision import content_digest
from core.scans.sensor import AngularGrid
from storage.errors import CorruptFile
from storage.files.map_file import read_map, read_parameters, write_map
from tests.support.map_files import replaced, whole_or_rejected
from tests.support.samples import sample_harmonic_map, sample_map


@pytest.fixture(scope="module")
def tensor_map():
    return sample_map(count=12, segment_length=4, drives=2)[0]


@pytest.fixture(params=[sample_map, sample_harmonic_map], ids=["paper", "harmonic"])
def of_either(request, tmp_path):
    """A map of each encoding, and its file."""
    made, _ = request.param(count=12, segment_length=4, drives=2)
    write_map(tmp_path / "map.h5", made)
    return tmp_path / "map.h5", made


def test_a_map_is_read_back_bit_by_bit(of_either):
    path, tensor_map = of_either
    again = read_map(path)
    assert again.revision == tensor_map.revision
    assert again.parameters == tensor_map.parameters
    assert again.attributes() == tensor_map.attributes()
    assert list(again.arrays()) == list(tensor_map.arrays())
    for name, array in tensor_map.arrays().items():
        np.testing.assert_array_equal(again.arrays()[name], array)
        assert again.arrays()[name].dtype == array.dtype


@pytest.mark.parametrize("poses", [True, False])
def test_a_map_with_or_without_poses_is_read_back(tmp_path, poses):
    made, _ = sample_map(count=6, segment_length=3, poses=poses)
    write_map(tmp_path / "map.h5", made)
    assert read_map(tmp_path / "map.h5").revision == made.revision


def test_a_path_and_a_map_in_the_other_order_are_refused(tmp_path, tensor_map):
    with pytest.raises(InvalidParameters, match=r"wanted write_map\(path, tensor_map\), got Posix"):
        write_map(tensor_map, tmp_path / "map.h5")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_read_as_a_map_has_a_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CorruptFile, match=r"^\. cannot be read as a map: it is a folder"):
        read_map(".")


def test_parameters_given_as_whole_numbers_come_back(tmp_path, tensor_map):
    grid = AngularGrid(-30, 10, 6, 20)
    parameters = MapParameters(grid=grid, ranks=[3, 4], sensor_height_m=2)  # type: ignore[arg-type]
    made = TensorMap(
        parameters,
        tensor_map.model,
        tensor_map.trajectory,
        tensor_map.topology,
        tensor_map.relative_error,
    )
    write_map(tmp_path / "map.h5", made)
    assert read_map(tmp_path / "map.h5").revision == made.revision


def test_the_time_of_writing_is_kept_outside_the_digest(tmp_path, tensor_map):
    for day in (1, 2):
        write_map(tmp_path / f"{day}.h5", tensor_map, datetime(2026, 1, day, tzinfo=UTC))
        with h5py.File(tmp_path / f"{day}.h5") as file:
            assert file.attrs["created_at"] == f"2026-01-0{day}T00:00:00+00:00"
            assert file.attrs["digest"] == tensor_map.revision
    assert read_map(tmp_path / "1.h5").revision == read_map(tmp_path / "2.h5").revision


def test_arrays_are_contiguous_and_unfiltered(path, tensor_map):
    with h5py.File(path) as file:
        assert set(file) == set(tensor_map.arrays())
        for dataset in file.values():
            assert dataset.chunks is None
            assert dataset.compression is None


def test_a_file_that_is_there_already_is_not_overwritten(path, tensor_map):
    with pytest.raises(FileExistsError):
        write_map(path, tensor_map)


def test_no_file_is_not_found(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_map(tmp_path / "none.h5")


@pytest.mark.parametrize("content", [b"", b"\x00" * 4096, b"no HDF5 at all", b"\x89HDF\r\n\x1a\n"])
def test_a_file_that_is_not_hdf5_is_corrupt(tmp_path, content):
    (tmp_path / "map.h5").write_bytes(content)
    with pytest.raises(CorruptFile, match="cannot be read as a map"):
        read_map(tmp_path / "map.h5")


def test_a_folder_is_corrupt(tmp_path):
    with pytest.raises(CorruptFile):
        read_map(tmp_path)


def test_a_flipped_byte_anywhere_is_rejected_or_without_effect(path, tensor_map):
    content = path.read_bytes()
    rng = np.random.default_rng(0)
    places = rng.integers(0, len(content), size=150)
    rejected = 0
    for place, bit in zip(places.tolist(), rng.integers(1, 256, size=150).tolist(), strict=True):
        damaged = bytearray(content)
        damaged[place] ^= bit
        path.write_bytes(damaged)
        rejected += whole_or_rejected(path, tensor_map.revision)
    assert rejected > 50


def test_a_flipped_byte_in_any_array_is_rejected(of_either):
    path, tensor_map = of_either
    content = path.read_bytes()
    with h5py.File(path) as file:
        spans = {
            name: (dataset.id.get_offset(), dataset.id.get_storage_size())
            for name, dataset in file.items()
        }
    rng = np.random.default_rng(1)
    for name, (offset, size) in spans.items():
        for place in rng.integers(offset, offset + size, size=6).tolist():
            damaged = bytearray(content)
            damaged[place] ^= 1 << int(rng.integers(8))
            path.write_bytes(damaged)
            assert whole_or_rejected(path, tensor_map.revision), f"{name}, byte {place}"


def test_a_truncated_file_is_corrupt(path):
    content = path.read_bytes()
    for length in np.linspace(1, len(content) - 1, 25).astype(int).tolist():
        path.write_bytes(content[:length])
        with pytest.raises(CorruptFile):
            read_map(path)


ARRAYS = list(sample_map(count=3, segment_length=3)[0].arrays())


@pytest.mark.parametrize("name", ARRAYS)
def test_a_missing_array_is_corrupt_and_named(path, name):
    replaced(path, name, None)
    with pytest.raises(CorruptFile, match=name):
        read_map(path)


@pytest.mark.parametrize("name", ARRAYS)
def test_an_array_of_another_kind_is_corrupt_and_named(path, tensor_map, name):
    array = tensor_map.arrays()[name]
    for other in (
        array.astype(np.float16),
        array.astype(np.complex64),
        array.astype("S8"),
        array.astype(array.dtype.newbyteorder(">")),
        h5py.Empty("f4"),
        np.array([(1, 2.0)], dtype=[("a", "i4"), ("b", "f4")]),
    ):
        replaced(path, name, other)
        with pytest.raises(CorruptFile, match=name):
            read_map(path)


@pytest.mark.parametrize("name", ARRAYS)
def test_an_array_of_another_shape_is_rejected(path, tensor_map, name):
    array = tensor_map.arrays()[name]
    for other in (array[:0], array[:-1], array[None], array.ravel()[0], np.repeat(array, 2, -1)):
        replaced(path, name, other)
        assert whole_or_rejected(path, "") is True


@pytest.mark.parametrize("name", ARRAYS)
def test_an_array_of_invalid_values_is_rejected(path, tensor_map, name):
    array = tensor_map.arrays()[name]
    fills = [-1, 10**15] if array.dtype.kind == "i" else [np.nan, np.inf, -1.0, 1e38]
    for fill in fills:
        replaced(path, name, np.full_like(array, fill))
        assert whole_or_rejected(path, "") is True


@pytest.mark.parametrize("wrong", ["shorter", "alike"])
def test_a_basis_whose_columns_are_not_orthonormal_is_rejected(of_either, wrong):
    path, tensor_map = of_either
    for name in {"radial_basis", "elevation_basis", "azimuth_basis"} & tensor_map.arrays().keys():
        arrays = tensor_map.arrays()
        basis = arrays[name].copy()
        basis[..., 1] = 0.9 * basis[..., 1] if wrong == "shorter" else basis[..., 0]
        arrays[name] = basis
        replaced(path, name, basis)
        with h5py.File(path, "r+") as file:
            file.attrs["digest"] = content_digest(arrays, tensor_map.attributes())
        with pytest.raises(CorruptFile, match=f"{name} has columns that are not orthonormal"):
            read_map(path)
        replaced(path, name, tensor_map.arrays()[name])


def test_an_array_the_format_does_not_know_is_corrupt(path):
    with h5py.File(path, "r+") as file:
        file["more"] = np.zeros(3)
    with pytest.raises(CorruptFile, match="more"):
        read_map(path)


def test_a_group_in_place_of_an_array_is_corrupt(path):
    with h5py.File(path, "r+") as file:
        del file["pose"]
        file.create_group("pose")
    with pytest.raises(CorruptFile, match="pose is no plain array"):
        read_map(path)


@pytest.mark.parametrize("link", [h5py.SoftLink("/signatures"), h5py.ExternalLink("b.h5", "/pose")])
def test_a_link_is_corrupt(path, tmp_path, link, tensor_map):
    write_map(tmp_path / "b.h5", tensor_map)
    with h5py.File(path, "r+") as file:
        del file["pose"]
        file["pose"] = link
    with pytest.raises(CorruptFile, match="pose is no plain array"):
        read_map(path)


def test_numbers_kept_in_another_file_are_corrupt(path, tmp_path, tensor_map):
    (tmp_path / "secret").write_bytes(bytes(10_000))
    array = tensor_map.arrays()["pose"]
    with h5py.File(path, "r+") as file:
        del file["pose"]
        file.create_dataset(
            "pose",
            array.shape,
            array.dtype,
            external=[(str(tmp_path / "secret"), 0, array.nbytes)],
        )
    with pytest.raises(CorruptFile, match="in another file"):
        read_map(path)


def test_a_virtual_array_is_corrupt(path, tmp_path, tensor_map):
    write_map(tmp_path / "b.h5", tensor_map)
    array = tensor_map.arrays()["pose"]
    layout = h5py.VirtualLayout(array.shape, array.dtype)
    layout[:] = h5py.VirtualSource(tmp_path / "b.h5", "pose", shape=array.shape)
    with h5py.File(path, "r+") as file:
        del file["pose"]
        file.create_virtual_dataset("pose", layout)
    with pytest.raises(CorruptFile, match="in another file"):
        read_map(path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"chunks": True}, "chunked"),
        ({"compression": "gzip"}, "filtered"),
        ({"fletcher32": True}, "filtered"),
    ],
)
def test_chunked_or_filtered_arrays_are_corrupt(path, tensor_map, options, message):
    replaced(path, "signatures", tensor_map.arrays()["signatures"], **options)
    with pytest.raises(CorruptFile, match=f"signatures is {message}"):
        read_map(path)


def test_the_list_of_the_chunks_of_a_map_is_not_read(path, tensor_map, monkeypatch):
    replaced(path, "signatures", tensor_map.arrays()["signatures"], chunks=True, fletcher32=True)
    monkeypatch.setattr(storage.hdf5.dataset, "read_fixed_array", None)
    with pytest.raises(CorruptFile, match="must be contiguous"):
        read_map(path)


@pytest.mark.parametrize("scans", [10**6, 10**15])
def test_an_array_larger_than_its_file_is_corrupt_before_memory_is_taken(path, scans):
    with h5py.File(path, "r+") as file:
        del file["signatures"]
        file.create_dataset("signatures", shape=(scans, 3, 4), dtype="<f4")  # never written
    with pytest.raises(CorruptFile, match="signatures"):
        read_map(path)


@pytest.mark.parametrize("version", [0, 4, "1.5", [1, 2]])
def test_another_format_version_is_corrupt(path, version):
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = version
    with pytest.raises(CorruptFile):
        read_map(path)


@pytest.mark.parametrize("name", ["format", "format_version", "attributes", "digest"])
def test_a_missing_attribute_is_corrupt(path, name):
    with h5py.File(path, "r+") as file:
        del file.attrs[name]
    with pytest.raises(CorruptFile):
        read_map(path)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "5",
        "null",
        '"text"',
        "[" * 50_000,
        '{"a":' * 10_000,
        "{}",
        "not JSON",
        '{"ranks": 1e999}',
    ],
)
def test_hostile_attributes_are_rejected(path, text):
    with h5py.File(path, "r+") as file:
        file.attrs["attributes"] = text
    with pytest.raises(CorruptFile):
        read_map(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ranks", [3.7, 4]),
        ("ranks", [3, 4, 5]),
        ("ranks", "34"),
        ("ranks", [float("inf"), 4]),
        ("ranks", [10**400, 4]),
        ("drives", 5),
        ("drives", "ab"),
        ("drives", ["drive-0"]),
        ("drives", [1, 2]),
        ("drives", None),
        ("sensor_height_m", float("nan")),
        ("sensor_height_m", "1.73"),
        ("sensor_height_m", 10**400),
        ("sensor", 5),
        ("sensor", ["a"]),
        ("encoding", "other"),
        ("reducer", ["last"]),
        ("reducer", {}),
        ("grid", {"rows": float("nan")}),
        ("grid", {"rows": 10**400}),
        ("grid", {"rows": "6"}),
        ("grid", {"columns": 19}),
        ("grid", []),
        ("grid", None),
        ("unknown", 1),
    ],
)
def test_an_attribute_that_cannot_be_is_rejected(path, tensor_map, name, value):
    attributes = tensor_map.attributes()
    if isinstance(value, dict):
        value = {**attributes["grid"], **value}
    with h5py.File(path, "r+") as file:
        file.attrs["attributes"] = json.dumps({**attributes, name: value})
    with pytest.raises(CorruptFile):
        read_map(path)


def test_another_digest_than_the_contents_is_corrupt_and_both_are_named(path, tensor_map):
    with h5py.File(path, "r+") as file:
        file.attrs["digest"] = "0" * 64
    with pytest.raises(
        CorruptFile, match=f"digest is {'0' * 64}, its content is {tensor_map.revision}"
    ):
        read_map(path)


def test_the_parameters_and_drives_of_a_file_are_those_of_its_map(of_either):
    path, made = of_either
    parameters, drives = read_parameters(path, made.revision)
    assert parameters == made.parameters
    assert list(drives.items()) == [(name, None) for name in made.trajectory.drives]


def test_the_parameters_of_a_file_with_another_digest_are_not_read(path, tensor_map):
    wrong = f"its digest is {tensor_map.revision}, not that of revision 0000"
    with pytest.raises(CorruptFile, match=wrong):
        read_parameters(path, "0" * 64)


@pytest.mark.parametrize("drives", ["drive-0", {"drive-0": 1}, None, 1, [1], ["drive-0", None]])
def test_the_parameters_of_a_file_whose_drives_are_no_names_are_not_read(path, tensor_map, drives):
    with h5py.File(path, "r+") as file:
        file.attrs["attributes"] = json.dumps({**tensor_map.attributes(), "drives": drives})
    with pytest.raises(CorruptFile, match="wanted a list of names"):
        read_parameters(path, tensor_map.revision)


def test_a_map_file_is_named_by_text_as_by_a_path(tmp_path, tensor_map) -> None:
    write_map(str(tmp_path / "map.h5"), tensor_map)
    assert read_map(str(tmp_path / "map.h5")).revision == tensor_map.revision
