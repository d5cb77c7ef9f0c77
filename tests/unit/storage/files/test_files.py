"""Atomic, durable files."""

import errno
import os
import stat
from contextlib import nullcontext
from pathlib import Path

import pytest

from storage.errors import StorageFailure, StorageFull, StorageReadOnly, StorageUnavailable
from storage.files.files import hidden_beside, hidden_files_of, make_folder, publish


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


def refused_as_there(path):
    """Write a file that is to be new, which another writer makes meanwhile."""

    def write():
        with publish(path, replaces=False) as part:
            part.write_bytes(b"ours")
            path.write_bytes(b"theirs")

    with pytest.raises(FileExistsError) as refused:
        write()
    return refused.value


@pytest.mark.parametrize("number", [None, errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS])
def test_a_file_that_is_to_be_new_replaces_none_that_another_writer_made_meanwhile(
    tmp_path, monkeypatch, number
):
    if number is not None:  # a file system without hard links, as exFAT
        monkeypatch.setattr(os, "link", failing(number))
    with publish(tmp_path / "a.h5", replaces=False) as part:
        part.write_bytes(b"new")
    assert (tmp_path / "a.h5").read_bytes() == b"new"
    refused = refused_as_there(tmp_path / "b.h5")
    assert (refused.filename2 or refused.filename) == str(tmp_path / "b.h5")
    assert (tmp_path / "b.h5").read_bytes() == b"theirs"
    assert sorted(names_in(tmp_path)) == ["a.h5", "b.h5"]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EIO])
def test_a_disk_error_of_a_file_that_is_to_be_new_has_its_name(tmp_path, monkeypatch, number):
    monkeypatch.setattr(os, "link", failing(number))
    with (
        pytest.raises(StorageFailure),
        publish(tmp_path / "a.h5", replaces=False) as part,
    ):
        part.write_bytes(b"new")
    assert names_in(tmp_path) == []


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (errno.EROFS, "{} cannot be written: make it writable"),
        (errno.ENOSPC, "no space is left in {}: free some, or raise the quota"),
    ],
)
def test_a_folder_that_is_full_or_read_only_is_named_as_the_caller_does(
    tmp_path, monkeypatch, number, said
):
    monkeypatch.setattr(os, "fsync", failing(number))
    path, other = tmp_path / "a.h5", "the folder of a.h5"
    with pytest.raises(StorageFailure) as failed, publish(path, where=other) as part:
        part.write_bytes(b"new")
    assert str(failed.value) == said.format(other)
    with pytest.raises(StorageFailure) as failed, publish(path) as part:
        part.write_bytes(b"new")
    assert str(failed.value) == said.format("the data directory")


@pytest.mark.parametrize("name", ["m" * 252 + ".h5", "ü" * 126 + ".h5", "m" * 101, "ü" * 51])
def test_the_longest_name_that_a_file_may_have_can_be_written(tmp_path, name):
    path = tmp_path / name
    with publish(path) as part:
        part.write_bytes(b"new")
        assert len(os.fsencode(part.name)) < 143  # the longest of encrypted folders
        part.name.encode()  # no character is cut
        other = hidden_beside(path)
        assert list(hidden_files_of(path)) == [part] != [other]
    assert names_in(tmp_path) == [name]


def test_another_runtime_error_passes(tmp_path):
    with pytest.raises(RuntimeError, match="else"), publish(tmp_path / "a.h5"):
        raise RuntimeError("something else")


def test_folders_are_made_with_their_parents_and_may_be_there(tmp_path):
    for _ in range(2):
        assert make_folder(tmp_path / "a" / "b").is_dir()


def test_a_link_to_a_folder_of_a_disk_that_is_not_mounted_is_named_as_that(tmp_path):
    (tmp_path / "data").symlink_to(tmp_path / "mounted" / "data")
    with pytest.raises(FileNotFoundError, match="links to a folder that is not there"):
        make_folder(tmp_path / "data")


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


@pytest.mark.parametrize("code", [errno.EINVAL, errno.EIO])
@pytest.mark.parametrize("kind", [stat.S_ISDIR, stat.S_ISREG])
def test_a_folder_of_a_share_that_cannot_sync_folders_takes_files(
    tmp_path, monkeypatch, code, kind
):
    fsync = os.fsync

    def refuse(descriptor):
        if kind(os.fstat(descriptor).st_mode):
            raise OSError(code, os.strerror(code))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", refuse)
    taken = code == errno.EINVAL and kind is stat.S_ISDIR  # which says that it cannot be done
    fails = nullcontext() if taken else pytest.raises((OSError, StorageUnavailable))
    with fails, publish(tmp_path / "backup.tar") as part:
        part.write_bytes(b"whole")
