"""The files of an index: what is read back is what was written, or is found to be damaged."""

import errno
import os
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from storage.errors import StorageFull
from storage.files.files import hidden_beside
from storage.files.place_files import VERSION, IndexedMap, Manifest, PlaceFiles

MAPS = [IndexedMap(map_id="m1", revision="r1", start=0, end=4)]


@pytest.fixture
def files(tmp_path):
    return PlaceFiles(tmp_path / "index")


def write(files):
    arrays = {"codes": np.arange(60, dtype=np.int8), "images": np.empty((4, 0, 60), np.uint8)}
    return files.write(arrays, MAPS)


def flip(path, at):
    content = bytearray(path.read_bytes())
    content[at] ^= 4
    path.write_bytes(content)


def test_a_part_is_read_as_it_was_written(files):
    part = write(files)
    assert files.matches_checksums(part)
    arrays = files.read(part.folder)
    assert arrays["codes"].tolist() == list(range(60))
    assert arrays["images"].shape == (4, 0, 60)


def test_what_a_killed_process_left_is_removed_with_the_next_manifest(files, tmp_path):
    with files.locked():
        part = write(files)
        killed = write(files)
        half_written = hidden_beside(tmp_path / "index" / "index.json")
        half_written.write_text("{")
        files.replace(Manifest(version=VERSION, parts=[part]))
    assert not (tmp_path / "index" / killed.folder).exists()
    assert not half_written.exists()
    left = {path.name for path in (tmp_path / "index").iterdir()}
    assert left == {"index.json", "lock", part.folder}


def test_a_part_that_does_not_fit_on_the_disk_leaves_nothing(files, tmp_path, monkeypatch):
    save = np.save

    def filled(path, array, **options):
        save(path, array, **options)
        if path.stem == "images":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as full:
        full.setattr(np, "save", filled)
        with pytest.raises(StorageFull):
            write(files)
    assert list((tmp_path / "index").iterdir()) == []
    usage = SimpleNamespace(total=2**40, free=2**24 + 59)  # what is kept for the catalog, and less
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with pytest.raises(StorageFull, match="a part of an index needs 60 bytes"):
        write(files)
    assert list((tmp_path / "index").iterdir()) == []


@pytest.mark.parametrize("at", [20, -60, -1])  # in the head of the file, and in its numbers
def test_one_bit_that_changed_is_found(files, tmp_path, at):
    part = write(files)
    flip(tmp_path / "index" / part.folder / "codes.npy", at)
    assert not files.matches_checksums(part)


@pytest.mark.parametrize("name", ["codes", "images"])
def test_a_part_that_lacks_an_array_does_not_match_its_checksums(files, tmp_path, name):
    part = write(files)
    (tmp_path / "index" / part.folder / f"{name}.npy").unlink()
    assert not files.matches_checksums(part)


def test_a_manifest_of_which_a_number_changed_is_none(files, tmp_path):
    manifest = Manifest(version=VERSION, parts=[write(files)])
    files.replace(manifest)
    assert files.manifest() == manifest
    path = tmp_path / "index" / "index.json"
    path.write_bytes(path.read_bytes().replace(b'"end":4', b'"end":5'))
    assert files.manifest() is None
