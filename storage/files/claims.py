"""Locks on what is being written, released when the process ends: unlocked it is abandoned."""

import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def claimed(make: Callable[[], Path]) -> Iterator[Path]:
    """Make a file or folder, locked against `remove_abandoned` of other processes in the block.

    Args:
        make: Makes it and returns its path; it is called again if another process removed what it
            made before that was locked.
    """
    descriptor = None
    while descriptor is None:
        path = make()
        descriptor = _locked(path)
    try:
        yield path
    finally:
        os.close(descriptor)


def remove_abandoned(path: Path) -> bool:
    """Remove a file or folder if no process holds it and it is this user's; return if it did."""
    try:
        if path.is_symlink() or path.stat().st_uid != os.geteuid():
            return False
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if not _is_open(path, descriptor):  # it was removed, and made again
            return False
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):
                path.unlink()
    except BlockingIOError:
        return False
    finally:
        os.close(descriptor)
    return not path.exists()


@contextmanager
def writing_in(folder: Path) -> Iterator[None]:
    """Keep `remove_half_written` from a folder in which a file is published in the block.

    Where the file system has no locks of folders, it finds none and removes nothing.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_SH)
        yield
    finally:
        os.close(descriptor)


def remove_half_written(folder: Path) -> None:
    """Remove what killed processes left of files of a folder, unless one is written there now.

    Args:
        folder: One in which all files are published within `writing_in`.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        with suppress(OSError):  # `BlockingIOError` if it is in use
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for left in folder.glob(".*.part"):
                left.unlink(missing_ok=True)
    finally:
        os.close(descriptor)


def _locked(path: Path) -> int | None:
    """Open and lock a file or folder; `None` if it was removed before it was locked."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
    except BaseException:
        os.close(descriptor)
        raise
    if _is_open(path, descriptor):
        return descriptor
    os.close(descriptor)
    return None


def _is_open(path: Path, descriptor: int) -> bool:
    """Return whether an open file or folder is the one of this path."""
    try:
        return os.path.samestat(path.lstat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False
