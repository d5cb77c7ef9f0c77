"""The lock of the one server that owns a data directory."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from storage.errors import DataDirInUse
from storage.files.files import named_disk_errors
from storage.store.held_folder import HeldFolder


class ServerLock:
    """A lock on a file that is released when the process ends, however that ends.

    Whoever holds it holds the folder of the file open as well: so it is known if another folder
    comes into its place, as a restored backup may. The catalog would still be that of the folder
    before, and files would be written into the new one.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor: int | None = None
        self._folder: HeldFolder | None = None

    def take(self) -> None:
        """Take the lock; a second call has no effect.

        Raises:
            DataDirInUse: If another process, or another store of this one, holds it.
            StorageReadOnly: If the directory cannot be written.
        """
        if self._descriptor is not None:
            return
        with named_disk_errors():
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
        if os.geteuid() == 0:  # as by `sudo tensormap verify`: the service could not open it
            with suppress(OSError):  # of a file system on which root may not
                folder = self._path.parent.stat()
                os.fchown(descriptor, folder.st_uid, folder.st_gid)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(descriptor)
            raise DataDirInUse(f"a service runs on {self._path.parent}: stop it first") from error
        self._descriptor = descriptor
        self._folder = HeldFolder(self._path.parent)

    def is_in_place(self) -> bool:
        """Return whether the folder that was locked is still the one of this path."""
        return self._folder is None or self._folder.is_in_place()

    def release(self) -> None:
        """Release the lock, if it is held."""
        if self._descriptor is not None:
            os.close(self._descriptor)
        if self._folder is not None:
            self._folder.release()
        self._descriptor = self._folder = None

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
