"""Space on the disk that is kept free: of uploads for scans, and of scans for the catalog."""

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from storage.errors import StorageFull


def has_inodes(folder: Path) -> bool:
    """Return whether another file fits on the file system of a folder, however short it is."""
    disk = os.statvfs(folder)
    return disk.f_favail > 0 or disk.f_files == 0  # the latter where it makes them as it needs them


@dataclass(frozen=True)
class Reserve:
    """Space that one kind of writing leaves free on a disk.

    Attributes:
        most_bytes: What is kept free of a large disk.
        part: Of a smaller disk, one of so many parts is kept free.
        purpose: What it is kept for, after "kept free".
    """

    most_bytes: int
    part: int
    purpose: str

    def left_bytes(self, folder: Path) -> int:
        """Return how many bytes may still be written on the disk of a folder."""
        disk = shutil.disk_usage(folder)
        return max(disk.free - self._kept_bytes(disk.total), 0)

    def require(self, folder: Path, size_bytes: int, what: str) -> None:
        """Reject what does not fit.

        Raises:
            StorageFull: If less is free.
        """
        disk = shutil.disk_usage(folder)
        kept_bytes = self._kept_bytes(disk.total)
        if disk.free < kept_bytes + size_bytes:
            kept = f", {kept_bytes} are kept free {self.purpose}" if kept_bytes else ""
            raise StorageFull(
                f"{what} needs {size_bytes} bytes; the disk has {disk.free} left{kept}"
            )

    def require_kept(self, folder: Path, what: str) -> None:
        """Reject what was written into this space; whoever wrote it removes it then.

        Raises:
            StorageFull: If less is left than is kept free.
        """
        disk = shutil.disk_usage(folder)
        kept_bytes = self._kept_bytes(disk.total)
        if disk.free < kept_bytes:
            raise StorageFull(
                f"{what} would leave {disk.free} bytes of the disk, {kept_bytes} are kept free"
                f" {self.purpose}"
            )

    def _kept_bytes(self, total_bytes: int) -> int:
        return min(total_bytes // self.part, self.most_bytes)


OF_UPLOADS = Reserve(2**30, 20, "of uploads")
"""Space for scans that are acknowledged while an upload comes."""

OF_SCANS = Reserve(2**24, 50, "for the catalog: delete something, or raise the quota")
"""Space for the catalog, in which a deletion must be written before it frees space."""

OF_NOTHING = Reserve(0, 1, "")
"""No space: of a disk on which no catalog is."""
