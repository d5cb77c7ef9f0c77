"""A folder that is held open, so that it is known if another comes into its place."""

import os
from pathlib import Path


class HeldFolder:
    """A folder that stays open until it is released.

    Its inode number is not reused meanwhile, and its disk cannot be unmounted without force.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)

    def is_in_place(self) -> bool:
        """Return whether it is still the one of its path."""
        try:
            return os.path.samestat(os.fstat(self._descriptor), self._path.stat())
        except OSError:
            return False

    def release(self) -> None:
        """Close it."""
        os.close(self._descriptor)
