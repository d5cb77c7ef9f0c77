"""Chunk files of raw scans."""

import errno

import h5py
import numpy as np
import pytest

from core.scans.scan import Scan
from storage.errors import CorruptFile
from storage.files.drive_chunks import ChunkFile, scan_digest, write_chunk


@pytest.fixture
def scans():
    rng = np.random.default_rng(1)
    sizes = {4: 5, 9: 0, 2: 70}
    return [
        (i, Scan.from_returns(rng.normal(size=(n, 3)), min_returns=0)) for i, n in sizes.items()
    ]


def test_scans_come_back_bit_for_bit(tmp_path, scans):
    write_chunk(tmp_path / "a.h5", scans)
    file = ChunkFile(tmp_path / "a.h5")
    for row, (_, scan) in enumerate(scans):
        back = file.points_m(row)
        assert back.tobytes() == scan.points_m.tobytes()
        assert scan_digest(back) == scan_digest(scan.points_m)


def test_the_file_is_packed_and_contiguous_and_has_its_format(tmp_path, scans):
    write_chunk(tmp_path / "a.h5", scans)
    with h5py.File(tmp_path / "a.h5") as file:
        assert dict(file.attrs) == {"format": "tensormap-drive-chunk", "format_version": 1}
        assert file["scan_start"][:].tolist() == [0, 5, 5, 75]
        assert file["scan_index"][:].tolist() == [4, 9, 2]
        assert (file["points_m"].dtype, file["points_m"].shape) == (np.dtype("<f4"), (75, 3))
        assert file["points_m"].chunks is None


def test_the_digest_is_of_the_returns_and_their_order_only():
    points = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    digest = scan_digest(np.array(points, np.float32))
    # printf of the six little-endian float32 through sha256sum
    assert digest == "24ae2dfe8df57c1b80e54cef3d90ac3b417fd98973345a5f616bbc9a75dcc202"
    assert digest == scan_digest(np.asfortranarray(np.array(points, ">f4")))
    assert digest != scan_digest(np.array(points[::-1], np.float32))


def test_a_row_that_is_not_there_is_corrupt(tmp_path, scans):
    write_chunk(tmp_path / "a.h5", scans)
    with pytest.raises(CorruptFile, match=r"row 3 of a\.h5"):
        ChunkFile(tmp_path / "a.h5").points_m(3)


def test_a_file_that_is_cut_off_after_it_was_opened_is_corrupt(tmp_path, scans):
    path = tmp_path / "a.h5"
    write_chunk(path, scans)
    file = ChunkFile(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: whole.index(scans[2][1].points_m.tobytes()) + 100])
    assert file.points_m(0).tobytes() == scans[0][1].points_m.tobytes()
    with pytest.raises(CorruptFile, match=r"row 2 of a\.h5 is cut off"):
        file.points_m(2)


def test_a_file_that_the_disk_no_longer_reads_is_corrupt(tmp_path, scans, monkeypatch):
    write_chunk(tmp_path / "a.h5", scans)
    file = ChunkFile(tmp_path / "a.h5")

    def fail(*_args, **_options):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(np, "fromfile", fail)
    with pytest.raises(CorruptFile, match=r"row 2 of a\.h5 cannot be read: .*Input/output"):
        file.points_m(2)


@pytest.mark.parametrize(
    "damage",
    [
        {"scan_start": np.array([], "<i8")},
        {"scan_start": np.array([0, 5, 4, 75], "<i8")},
        {"scan_start": np.array([0, 5, 5, 75], "<f8")},
        {"scan_start": np.array([0, 5, 5, 76], "<i8")},
        {"points_m": np.zeros((75, 3), "<f8")},
        {"points_m": np.zeros(75 * 3, "<f4")},
    ],
)
def test_scans_that_do_not_lie_one_after_the_other_are_corrupt(tmp_path, scans, damage):
    write_chunk(tmp_path / "a.h5", scans)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        for name, array in damage.items():
            del file[name]
            file[name] = array
    with pytest.raises(CorruptFile, match="one after the other"):
        ChunkFile(tmp_path / "a.h5")


@pytest.mark.parametrize("content", [b"", b"no HDF5 at all"])
def test_another_file_is_corrupt(tmp_path, content):
    (tmp_path / "a.h5").write_bytes(content)
    with pytest.raises(CorruptFile):
        ChunkFile(tmp_path / "a.h5").points_m(0)


def test_a_truncated_file_is_corrupt(tmp_path, scans):
    write_chunk(tmp_path / "a.h5", scans)
    whole = (tmp_path / "a.h5").read_bytes()
    (tmp_path / "a.h5").write_bytes(whole[: len(whole) - 100])
    with pytest.raises(CorruptFile):
        ChunkFile(tmp_path / "a.h5").points_m(2)


def test_a_chunk_of_a_later_version_is_rejected(tmp_path, scans):
    write_chunk(tmp_path / "a.h5", scans)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file.attrs["format_version"] = 2
    with pytest.raises(CorruptFile, match="version 1"):
        ChunkFile(tmp_path / "a.h5").points_m(0)


def test_a_missing_file_is_not_a_corrupt_one(tmp_path):
    with pytest.raises(FileNotFoundError):
        ChunkFile(tmp_path / "a.h5").points_m(0)
