"""One server owns a data directory: a lock says which."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from storage.errors import DataDirInUse


class ServerLock:
    """A lock on a file that ends with the process, however that ends."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor: int | None = None

    def take(self) -> None:
        """Take the lock; taking it twice is taking it once.

        Raises:
            DataDirInUse: If another process, or another store of this one, holds it.
        """
        if self._descriptor is not None:
            return
        descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(descriptor)
            raise DataDirInUse(f"another server runs on {self._path.parent}") from error
        self._descriptor = descriptor

    def release(self) -> None:
        """Give the lock back, if it is held."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the lock for a block, or go on holding it.

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
