"""What may be removed as abandoned: nothing that is in use, another user's, or elsewhere."""

import errno
import fcntl
import os
from pathlib import Path
from tempfile import mkdtemp

import pytest

from storage.files.claims import claimed, remove_abandoned, remove_half_written, writing_in


@pytest.fixture(params=["file", "folder"])
def left(request, tmp_path):
    path = tmp_path / "left.part"
    if request.param == "folder":
        (path / "maps").mkdir(parents=True)
    else:
        path.write_bytes(b"half")
    return path


def test_what_is_claimed_is_removed_only_after_that(left):
    with claimed(lambda: left):
        assert not remove_abandoned(left)
        assert left.exists()
    assert remove_abandoned(left)
    assert not left.exists()


def test_what_is_another_users_stays(left, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: left.stat().st_uid + 1)
    assert not remove_abandoned(left)
    assert left.exists()


def test_a_link_stays_and_so_does_what_it_leads_to(left):
    link = left.with_name("link.part")
    link.symlink_to(left)
    assert not remove_abandoned(link)
    assert link.is_symlink()
    assert left.exists()


def test_nothing_is_removed_where_nothing_is(tmp_path):
    assert not remove_abandoned(tmp_path / "left.part")


@pytest.mark.parametrize("when", ["before it is opened", "before it is locked"])
def test_what_is_removed_before_it_is_claimed_is_made_again(tmp_path, monkeypatch, when):
    lock = fcntl.flock
    removed: list[Path] = []

    def remove(path):
        if not removed:
            assert remove_abandoned(path)
            removed.append(path)

    def make():
        path = Path(mkdtemp(dir=tmp_path))
        if when == "before it is opened":
            remove(path)
        return path

    def lock_late(descriptor, operation):
        if operation == fcntl.LOCK_EX:
            remove(Path(f"/proc/self/fd/{descriptor}").readlink())
        lock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", lock_late)
    with claimed(make) as path:
        assert not remove_abandoned(path)
        assert [path] == list(tmp_path.iterdir())
    assert len(removed) == 1
    assert remove_abandoned(path)


def test_what_was_made_again_under_the_same_name_stays(left, monkeypatch):
    lock = fcntl.flock

    def lock_late(descriptor, operation):
        left.rename(left.with_name("removed"))
        left.touch()
        lock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", lock_late)
    assert not remove_abandoned(left)
    assert left.exists()


def test_what_is_half_written_is_removed_once_nobody_writes_in_its_folder(tmp_path):
    left, whole = tmp_path / ".images.h5.12.part", tmp_path / "images.h5"
    for path in (left, whole):
        path.write_bytes(b"images")
    with writing_in(tmp_path):
        with writing_in(tmp_path):  # two write at a time
            remove_half_written(tmp_path)
        remove_half_written(tmp_path)
        assert left.exists()
    remove_half_written(tmp_path)
    assert list(tmp_path.iterdir()) == [whole]


def test_nothing_is_removed_as_half_written_where_no_folder_can_be_locked(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    left = tmp_path / ".images.h5.12.part"
    with writing_in(tmp_path):
        left.touch()
        remove_half_written(tmp_path)
    remove_half_written(tmp_path / "none")
    assert left.exists()
