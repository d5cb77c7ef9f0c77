"""Publishing files: fsynced and renamed, so that they are whole under their name or not there."""

import errno
import os
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from storage.errors import StorageError, StorageFull, StorageReadOnly, StorageUnavailable

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}  # the last is `ulimit -f`
_READ_ONLY = {errno.EROFS, errno.EACCES, errno.EPERM}
_FAILING = {errno.EIO, errno.ENXIO, errno.ESTALE, errno.ETIMEDOUT}  # the last two: a network's


@contextmanager
def publish(
    path: Path, *, synced: bool = False, instead: Callable[[], Path] | None = None
) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path`, then rename it to `path`.

    When the block ends, the file is fsynced, renamed and its folder fsynced: after that, it
    survives a power failure. When anything up to the rename fails, nothing is left behind and
    `path` is as before; when only the folder's fsync fails, the new file is there but may be lost
    in a power failure. Of two writers the last rename wins.

    Args:
        path: The file.
        synced: Whether the block syncs it.
        instead: Returns, once it is written, another file of the same folder to rename it to.

    Raises:
        StorageFull: If no space or quota is left.
        StorageReadOnly: If the folder cannot be written.
        StorageUnavailable: If the disk fails.

    Examples:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "greeting.txt"
        >>> with publish(path) as part:
        ...     _ = part.write_text("hello")
        ...     path.exists()
        False
        >>> path.read_text(), part.exists()
        ('hello', False)
    """
    part = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")
    try:
        with named_disk_errors():
            yield part
            if not synced:
                sync(part)
            # Not more readable than its folder, whatever the umask.
            part.chmod(part.stat().st_mode & path.parent.stat().st_mode & 0o666)
            part.rename(path if instead is None else instead())
            sync(path.parent)
    except BaseException:
        discard(part)
        raise


@contextmanager
def named_disk_errors() -> Iterator[None]:
    """Raise the named error of a full, read-only or failing disk; other errors pass through.

    Its text is for everybody: the path is in its cause only.

    Raises:
        StorageFull: If no space or quota is left.
        StorageReadOnly: If the folder cannot be written.
        StorageUnavailable: If the disk fails.
    """
    try:
        yield
    except OSError as error:
        if error.errno in _FULL:
            raise StorageFull("no space is left to write: free some, or raise the quota") from error
        if error.errno in _READ_ONLY:
            raise StorageReadOnly(
                "the data directory cannot be written: make it writable"
            ) from error
        if error.errno in _FAILING:
            raise StorageUnavailable("the disk fails: check it") from error
        raise


def discard(path: Path) -> None:
    """Remove a useless file if possible; a start sets aside what is left.

    If the disk became read-only, the first error is the one to raise, not that of the removal.
    """
    with suppress(OSError):
        path.unlink(missing_ok=True)


@contextmanager
def discarded_on_rollback(path: Path) -> Iterator[None]:
    """Remove a new file if the block, which commits the rows that name it, committed nothing.

    That is not certain after `StorageUnavailable`, because the connection may have been lost after
    the commit, nor after an error that storage does not name. The file is then kept: an orphan,
    which the next start sets aside, is better than a row without its file.

    Examples:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "scans.h5"
        >>> for error in (StorageUnavailable, StorageFull):
        ...     with suppress(error), discarded_on_rollback(path):
        ...         path.touch()
        ...         raise error
        ...     path.exists()
        True
        False
    """
    try:
        yield
    except StorageUnavailable:
        raise
    except StorageError:
        discard(path)
        raise


def sync(path: Path) -> None:
    """Wait until a file's content, or a folder's entries, are on disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(path: Path) -> Path:
    """Make a folder and its parents, durably, if there is none, and return it.

    Only this user has access to it.

    Raises:
        StorageFull: If no space or quota is left.
        StorageReadOnly: If its parent cannot be written.
    """
    if not path.is_dir():
        make_folder(path.parent)
        with named_disk_errors():
            path.mkdir(0o700, exist_ok=True)
            sync(path.parent)
    return path


def entries(folder: Path) -> list[Path]:
    """Return what a folder has: nothing if there is none, or it is removed meanwhile."""
    try:
        return list(folder.iterdir())
    except (FileNotFoundError, NotADirectoryError):
        return []
