"""The lock of the one server that owns a data directory."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from storage.errors import DataDirInUse, StorageUnavailable
from storage.files.files import named_disk_errors


class ServerLock:
    """A lock on a file that is released when the process ends, however that ends."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor: int | None = None

    def take(self) -> None:
        """Take the lock; a second call has no effect.

        Raises:
            DataDirInUse: If another process, or another store of this one, holds it.
            StorageReadOnly: If the directory cannot be written.
            StorageUnavailable: If its file system has no locks.
        """
        if self._descriptor is not None:
            return
        with named_disk_errors():
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
        if os.geteuid() == 0:  # as by `sudo tensormap verify`: the service could not open it
            self._give_to_owner(descriptor)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            folder = self._path.parent
            if isinstance(error, BlockingIOError):
                raise DataDirInUse(
                    f"a service or a command uses {folder}: stop it first, or wait"
                ) from error
            raise StorageUnavailable(
                f"the file system of {folder} cannot lock files: {error.strerror}"
            ) from error
        self._descriptor = descriptor

    def _give_to_owner(self, descriptor: int) -> None:
        """Give a file of root's to the owner of its folder, but none that a link leads to."""
        with suppress(OSError):  # of a file system on which root may not
            opened, folder = os.fstat(descriptor), self._path.parent.stat()
            is_here = os.path.samestat(opened, self._path.lstat()) and opened.st_nlink == 1
            if is_here and opened.st_uid == 0:
                os.fchown(descriptor, folder.st_uid, folder.st_gid)

    def release(self) -> None:
        """Release the lock, if it is held."""
        if self._descriptor is not None:
            os.close(self._descriptor)
        self._descriptor = None

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the lock for a block; one that is held already stays held after it.

        Raises:
            DataDirInUse: If another process, or another store of this one, holds it.
        """
        was_held = self._descriptor is not None
        self.take()
        try:
            yield
        finally:
            if not was_held:
                self.release()
