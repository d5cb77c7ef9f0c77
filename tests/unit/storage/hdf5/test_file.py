"""Hostile and damaged HDF5: each structure is bounded, checked, and rejected with a named error."""

import io
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest

from core.revision import content_digest
from storage.errors import CorruptFile
from storage.files.json_text import parse_json
from storage.files.map_file import _CheckedFiles, map_of_bytes, read_map, read_revision, write_map
from storage.hdf5 import BytesSource, FileSource, Hdf5File
from tests import golden
from tests.support.older_files import copied_map
from tests.support.samples import sample_map

MAP, _ = sample_map(count=3, segment_length=3)

READ = """
import sys
from pathlib import Path
from core.errors import TensorMapError
from storage.files.map_file import read_map
try:
    read_map(Path(sys.argv[1]))
except TensorMapError as error:
    print(type(error).__name__, error)
"""


@pytest.fixture(params=[write_map, copied_map])
def whole(request, tmp_path):
    """The bytes of a map, in HDF5's newer and its first structures."""
    request.param(tmp_path / "whole.h5", MAP)
    return bytearray((tmp_path / "whole.h5").read_bytes())


def read_in_a_child(path):
    """Read a map in another process; return what it printed, an error if it does not end."""
    child = subprocess.run(
        [sys.executable, "-c", READ, str(path)], capture_output=True, text=True, timeout=60
    )
    assert child.returncode == 0, f"it ended with {child.returncode}: {child.stderr}"
    return child.stdout


@pytest.mark.parametrize("bit", [1, 2, 3])
def test_a_text_of_another_size_in_the_global_heap_is_rejected_in_time(tmp_path, bit):
    """HDF5 2.0.0 never ends on it: the collection's next object begins nowhere."""
    older = bytearray((Path(golden.__file__).parent / "map-v1.h5").read_bytes())
    older[older.index(b"GCOL") + 16 + 9] ^= 1 << bit  # the size of the first text
    (tmp_path / "harmed.h5").write_bytes(older)
    assert "CorruptFile" in read_in_a_child(tmp_path / "harmed.h5")


def test_every_bit_of_the_description_of_a_text_may_flip(whole):
    """One of them ended the process in HDF5 2.0.0."""
    at = whole.index(bytes.fromhex("19010100"))
    for number in range(8 * 24):
        flipped = bytearray(whole)
        flipped[at + number // 8] ^= 1 << number % 8
        with suppress(CorruptFile):
            assert map_of_bytes(bytes(flipped), "it").revision == MAP.revision, f"bit {number}"


def test_a_header_that_continues_in_itself_ends(tmp_path):
    content = bytearray(copied_map(tmp_path / "a.h5", MAP).read_bytes())
    root = int.from_bytes(content[64:72], "little")
    size = int.from_bytes(content[root + 8 : root + 12], "little")
    content[root + 2 : root + 4] = (65535).to_bytes(2, "little")
    again = b"\x10\0\x10\0\0\0\0\0" + (root + 16).to_bytes(8, "little") + size.to_bytes(8, "little")
    content[root + 16 : root + 16 + len(again)] = again
    with pytest.raises(CorruptFile, match="pieces"):
        Hdf5File(BytesSource(bytes(content)))


@pytest.mark.parametrize("shape", [(2**62,), (2**40, 2**40), (2**63, 0, 2**63), (7,) * 7])
def test_a_shape_beyond_the_file_takes_no_memory(shape):
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file["a"] = np.zeros((2,) * len(shape))
    content = bytearray(buffer.getvalue())
    was = np.array((2,) * len(shape), "<u8").tobytes()
    at = content.index(was)
    for axis, length in enumerate(shape * 2):  # and how long they may become
        content[at + 8 * axis : at + 8 * axis + 8] = length.to_bytes(8, "little")
    try:
        found = Hdf5File(BytesSource(bytes(content))).dataset("a").read()
    except CorruptFile:
        return
    assert found.size == 0


def test_chunks_of_an_array_without_numbers_are_not_counted():
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver="v110") as file:
        shape, most = (0, 5, 8), (2**40, 5, 8)
        file.create_dataset("a", shape, "f4", maxshape=most, chunks=(1, 5, 8), fletcher32=True)
    assert Hdf5File(BytesSource(buffer.getvalue())).dataset("a").read().shape == shape


def test_chunks_of_less_than_whole_rows_are_rejected():
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver="v110") as file:
        file.create_dataset("a", data=np.eye(4), chunks=(1, 2), fletcher32=True)
    with pytest.raises(CorruptFile, match=r"chunks of shape \[1, 2\]"):
        Hdf5File(BytesSource(buffer.getvalue())).dataset("a")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.create_dataset("a", data=np.zeros(9), compression="gzip"), "filtered"),
        (lambda f: f.create_dataset("a", data=np.zeros(9), chunks=(2,)), "chunked"),
        (lambda f: f.create_dataset("a", data=np.zeros(3, ">f8")), "kind"),
        (lambda f: f.create_dataset("a", data=np.zeros(3, np.float16)), "kind"),
        (lambda f: f.create_dataset("a", data=h5py.Empty("f8")), "no shape"),
        (lambda f: f.create_dataset("a", data=["text"]), "items of any length"),
        (lambda f: f.create_group("a"), "no plain array"),
        (lambda f: f.__setitem__("a", np.dtype("f8")), "no plain array"),
        (lambda f: f.__setitem__("a", h5py.SoftLink("/b")), "a link elsewhere"),
        (lambda f: f.__setitem__("a", h5py.ExternalLink("b.h5", "/b")), "a link elsewhere"),
        (lambda f: [f.create_dataset(f"{i}", data=0) for i in range(70)], "members"),
        (lambda f: f.attrs.update({str(i): i for i in range(70)}), "attributes|too many"),
    ],
)
@pytest.mark.parametrize("libver", [None, "v110"])
def test_structures_that_these_files_never_have_are_rejected_by_name(change, message, libver):
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=libver) as file:
        change(file)
    with pytest.raises(CorruptFile, match=message):
        Hdf5File(BytesSource(buffer.getvalue())).dataset("a")


@pytest.mark.parametrize("value", [np.array([1, 2]), 1.5, np.bytes_(b"text"), h5py.Empty("i8")])
def test_an_attribute_of_another_kind_is_rejected_when_it_is_looked_up_only(value):
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file.attrs["odd"], file.attrs["plain"] = value, 1
    attributes = Hdf5File(BytesSource(buffer.getvalue())).attributes
    assert attributes.whole("plain") == 1
    for look in (attributes.whole, lambda name: attributes.text(name, 99)):
        with pytest.raises(CorruptFile, match="odd"):
            look("odd")


def test_a_text_that_is_no_utf_8_or_too_long_is_rejected():
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file.attrs["a"] = "ä" * 10
    content = buffer.getvalue()
    with pytest.raises(CorruptFile, match="at most 19"):
        Hdf5File(BytesSource(content)).attributes.text("a", 19)
    with pytest.raises(CorruptFile, match="UTF-8"):
        Hdf5File(BytesSource(content.replace("ä".encode(), b"\xc3("))).attributes.text("a", 99)


@pytest.mark.parametrize(
    "text",
    [
        '{"drives": ["\\ud800"]}',
        '{"\\udfff": 1}',
        '["\\ud83d\\ud83d"]',
        "[" * 17 + "]" * 17,
        "[" * 100_000,
        '{"a":' * 5_000,
        "1" * 5000,
        "{",
    ],
)
def test_json_of_half_a_surrogate_pair_or_too_deep_is_rejected(text):
    with pytest.raises(CorruptFile):
        parse_json(text, "it")


def test_json_with_whole_pairs_is_text():
    assert parse_json('{"\\ud83d\\ude00": [["\\u0000", null, 1.5]]}', "it") == {
        "\N{GRINNING FACE}": [["\0", None, 1.5]]
    }


def test_a_file_that_becomes_shorter_while_it_is_read_is_corrupt(tmp_path):
    write_map(tmp_path / "a.h5", MAP)
    with FileSource(tmp_path / "a.h5") as source:
        file = Hdf5File(source)
        with (tmp_path / "a.h5").open("r+b") as opened:
            opened.truncate(60)
        with pytest.raises(CorruptFile, match="shorter"):
            file.dataset("pose").read()


def test_the_digest_of_a_revision_is_computed_once_and_again_after_a_change(tmp_path, monkeypatch):
    path = tmp_path / "a.h5"
    write_map(path, MAP)
    computed = []

    def counted(*parts):
        computed.append(parts)
        return content_digest(*parts)

    monkeypatch.setattr("core.mapping.tensormap.content_digest", counted)
    monkeypatch.setattr("storage.files.map_file._checked", _CheckedFiles())
    for _ in range(3):
        assert read_revision(path, MAP.revision).revision == MAP.revision
    assert len(computed) == 1
    monkeypatch.undo()
    content = bytearray(path.read_bytes())
    content[content.index(MAP.trajectory.poses.tobytes()) + 3] ^= 1
    path.write_bytes(content)
    with pytest.raises(CorruptFile, match="its content is"):
        read_revision(path, MAP.revision)


def test_a_whole_file_of_another_revision_is_rejected(tmp_path):
    write_map(tmp_path / "a.h5", MAP)
    for _ in range(2):
        with pytest.raises(CorruptFile, match=f"holds {MAP.revision}"):
            read_revision(tmp_path / "a.h5", "0" * 64)
    assert read_map(tmp_path / "a.h5").revision == MAP.revision
