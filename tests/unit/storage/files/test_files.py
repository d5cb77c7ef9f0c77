"""Atomic, durable files."""

import errno
import os
from pathlib import Path

import pytest

from storage.errors import StorageFull, StorageReadOnly, StorageUnavailable
from storage.files.files import make_folder, publish


def names_in(folder):
    return [path.name for path in folder.iterdir()]


def failing(number):
    def fail(*_args, **_kwargs):
        raise OSError(number, os.strerror(number))

    return fail


def test_a_file_appears_whole_when_the_block_ends(tmp_path):
    with publish(tmp_path / "a.h5") as part:
        part.write_bytes(b"new")
        assert part.parent == tmp_path
        assert not (tmp_path / "a.h5").exists()
    assert names_in(tmp_path) == ["a.h5"]
    assert (tmp_path / "a.h5").read_bytes() == b"new"


def test_an_error_in_the_block_leaves_the_earlier_file(tmp_path):
    (tmp_path / "a.h5").write_bytes(b"old")
    with pytest.raises(ZeroDivisionError), publish(tmp_path / "a.h5") as part:  # noqa: PT012  # half-written
        part.write_bytes(b"half")
        raise ZeroDivisionError
    assert names_in(tmp_path) == ["a.h5"]
    assert (tmp_path / "a.h5").read_bytes() == b"old"


def test_the_file_is_synced_before_the_rename_and_the_folder_after_it(tmp_path, monkeypatch):
    seen = []
    fsync = os.fsync

    def spy(descriptor):
        target = str(Path(f"/proc/self/fd/{descriptor}").readlink())
        seen.append((target.endswith(".part"), (tmp_path / "a.h5").exists()))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", spy)
    with publish(tmp_path / "a.h5") as part:
        part.write_bytes(b"new")
    assert seen == [(True, False), (False, True)]


@pytest.mark.parametrize(
    ("number", "named"),
    [
        (errno.ENOSPC, StorageFull),
        (errno.EDQUOT, StorageFull),
        (errno.EROFS, StorageReadOnly),
        (errno.EIO, StorageUnavailable),
    ],
)
@pytest.mark.parametrize("call", ["fsync", "rename"])
def test_a_disk_error_has_its_name_and_leaves_nothing(tmp_path, monkeypatch, number, named, call):
    monkeypatch.setattr(os, call, failing(number))
    with pytest.raises(named), publish(tmp_path / "a.h5") as part:
        part.write_bytes(b"new")
    assert names_in(tmp_path) == []


def test_another_runtime_error_passes(tmp_path):
    with pytest.raises(RuntimeError, match="else"), publish(tmp_path / "a.h5"):
        raise RuntimeError("something else")


def test_folders_are_made_with_their_parents_and_may_be_there(tmp_path):
    for _ in range(2):
        assert make_folder(tmp_path / "a" / "b").is_dir()
