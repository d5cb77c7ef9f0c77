"""Publishing files: fsynced and renamed, so that they are whole under their name or not there."""

import errno
import os
import secrets
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path

from storage.errors import StorageError, StorageFull, StorageReadOnly, StorageUnavailable

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}  # the last is `ulimit -f`
_READ_ONLY = {errno.EROFS, errno.EACCES, errno.EPERM}
_FAILING = {errno.EIO, errno.ENXIO, errno.ESTALE, errno.ETIMEDOUT}  # the last two: a network's
_NO_LINKS = {errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK}
_MOST_HIDDEN_BYTES = 100  # of a name: the longest has 255, in an encrypted folder 143
_DATA_DIR = "the data directory"


@contextmanager
def publish(
    path: Path,
    *,
    synced: bool = False,
    replaces: bool = True,
    instead: Callable[[], Path] | None = None,
    where: str = _DATA_DIR,
) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path`, then rename it to `path`.

    When the block ends, the file is fsynced, renamed and its folder fsynced: after that, it
    survives a power failure. When anything up to the rename fails, nothing is left behind and
    `path` is as before; when only the folder's fsync fails, the new file is there but may be lost
    in a power failure. Of two writers the last rename wins, unless the file is to be new.

    Args:
        path: The file.
        synced: Whether the block syncs it.
        replaces: Whether it replaces a file that is there; else it is new, or an error.
        instead: Returns, once it is written, another file of the same folder to rename it to.
        where: Name of the folder in errors.

    Raises:
        FileExistsError: If another file is there by the end, which is to be new.
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
    part = hidden_beside(path)
    try:
        with named_disk_errors(where):
            yield part
            if not synced:
                sync(part)
            # Not more readable than its folder, whatever the umask.
            part.chmod(part.stat().st_mode & path.parent.stat().st_mode & 0o666)
            named = path if instead is None else instead()
            if replaces:
                part.rename(named)
            else:
                _rename_to_new(part, named)
            sync(path.parent)
    except BaseException:
        discard(part)
        raise


def _rename_to_new(part: Path, path: Path) -> None:
    """Rename a file unless there is another one, which a rename would replace.

    Raises:
        FileExistsError: If there is one.
    """
    try:
        os.link(part, path)
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from None
        part.rename(path)
    else:
        discard(part)


def hidden_beside(path: Path) -> Path:
    """Return a new hidden path beside one, for what is renamed to it once it is complete."""
    return path.with_name(f"{_hidden(path)}{secrets.token_hex(8)}.part")


def hidden_files_of(path: Path) -> Iterator[Path]:
    """Yield the hidden paths beside one that are there: it is written, or a writer was killed."""
    return path.absolute().parent.glob(f"{escape(_hidden(path))}*.part")


def _hidden(path: Path) -> str:
    name = path.name
    while len(os.fsencode(name)) > _MOST_HIDDEN_BYTES:
        name = name[:-1]
    return f".{name}."


@contextmanager
def named_disk_errors(where: str = _DATA_DIR) -> Iterator[None]:
    """Raise the named error of a full, read-only or failing disk; other errors pass through.

    Its text is for everybody: the path is in its cause only.

    Args:
        where: Name of what is written, in errors.

    Raises:
        StorageFull: If no space or quota is left.
        StorageReadOnly: If the folder cannot be written.
        StorageUnavailable: If the disk fails.
    """
    try:
        yield
    except OSError as error:
        if error.errno in _FULL:
            raise StorageFull(
                f"no space is left in {where}: free some, or raise the quota"
            ) from error
        if error.errno in _READ_ONLY:
            raise StorageReadOnly(f"{where} cannot be written: make it writable") from error
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
    """Wait until a file's content, or a folder's entries, are on disk.

    Shares of some networks, on which a backup may be, do that for files only.
    """
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL or not stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise
    finally:
        os.close(descriptor)


def make_folder(path: Path) -> Path:
    """Make a folder and its parents, durably, if there is none, and return it.

    Only this user has access to it.

    Raises:
        FileNotFoundError: If it is a link to a folder that is not there.
        StorageFull: If no space or quota is left.
        StorageReadOnly: If its parent cannot be written.
    """
    require_no_lost_link(path)
    if not path.is_dir():
        make_folder(path.parent)
        with named_disk_errors():
            path.mkdir(0o700, exist_ok=True)
            sync(path.parent)
    return path


def require_no_lost_link(path: Path) -> None:
    """Reject a link to a folder that is not there, as of a disk that is not mounted.

    Raises:
        FileNotFoundError: If it is one.
    """
    if path.is_symlink() and not path.exists():
        raise FileNotFoundError(errno.ENOENT, "it links to a folder that is not there", str(path))


def entries(folder: Path) -> list[Path]:
    """Return what a folder has: nothing if there is none, or it is removed meanwhile."""
    try:
        return list(folder.iterdir())
    except (FileNotFoundError, NotADirectoryError):
        return []
