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
        (errno.EFBIG, StorageFull),
        (errno.EROFS, StorageReadOnly),
        (errno.EACCES, StorageReadOnly),
        (errno.EPERM, StorageReadOnly),
        (errno.EIO, StorageUnavailable),
        (errno.ENXIO, StorageUnavailable),
        (errno.ESTALE, StorageUnavailable),
        (errno.ETIMEDOUT, StorageUnavailable),
    ],
)
@pytest.mark.parametrize("call", ["fsync", "rename"])
def test_a_disk_error_has_its_name_and_leaves_nothing(tmp_path, monkeypatch, number, named, call):
    monkeypatch.setattr(os, call, failing(number))
    with pytest.raises(named), publish(tmp_path / "a.h5") as part:
        part.write_bytes(b"new")
    assert names_in(tmp_path) == []


@pytest.mark.parametrize("call", ["fsync", "rename"])
def test_an_error_of_the_system_without_a_name_passes_and_leaves_nothing(
    tmp_path, monkeypatch, call
):
    monkeypatch.setattr(os, call, failing(errno.ENAMETOOLONG))
    with pytest.raises(OSError, match="too long") as failed, publish(tmp_path / "a.h5") as part:
        part.write_bytes(b"new")
    assert failed.value.errno == errno.ENAMETOOLONG
    assert names_in(tmp_path) == []


def test_another_runtime_error_passes(tmp_path):
    with pytest.raises(RuntimeError, match="else"), publish(tmp_path / "a.h5"):
        raise RuntimeError("something else")


def test_folders_are_made_with_their_parents_and_may_be_there(tmp_path):
    for _ in range(2):
        assert make_folder(tmp_path / "a" / "b").is_dir()


def test_the_folder_above_is_synced_when_one_was_made_in_it(tmp_path, monkeypatch):
    synced = []
    fsync = os.fsync

    def spy(descriptor):
        folder = Path(f"/proc/self/fd/{descriptor}").readlink()
        synced.append((folder.relative_to(tmp_path), names_in(folder)))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", spy)
    make_folder(tmp_path / "a" / "b")
    assert synced == [(Path(), ["a"]), (Path("a"), ["b"])]
    make_folder(tmp_path / "a" / "b")
    assert len(synced) == 2


def test_a_folder_that_is_made_is_this_users_only(tmp_path):
    make_folder(tmp_path / "a" / "b")
    assert [(tmp_path / name).stat().st_mode & 0o777 for name in ("a", "a/b")] == [0o700, 0o700]
