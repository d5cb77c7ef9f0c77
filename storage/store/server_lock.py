"""The lock of the one server that owns a data directory."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from storage.errors import DataDirInUse
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
        """
        if self._descriptor is not None:
            return
        with named_disk_errors():
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(descriptor)
            raise DataDirInUse(f"a service runs on {self._path.parent}: stop it first") from error
        self._descriptor = descriptor

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
