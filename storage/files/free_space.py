"""Space on the disk that uploads leave free, for acknowledged scans, and that scans leave free."""

import shutil
from pathlib import Path

from storage.errors import StorageFull

_KEPT_FREE_BYTES = 2**30  # of a large disk; of a small one a twentieth
_KEPT_FOR_CATALOG_BYTES = 2**24  # of a large disk; of a small one a fiftieth


def free_bytes(folder: Path) -> int:
    """Return how many bytes uploads may still take on the disk of a folder."""
    disk = shutil.disk_usage(folder)
    return max(disk.free - _kept_free(disk.total), 0)


def require_free(folder: Path, size_bytes: int, what: str) -> None:
    """Reject what does not fit.

    Raises:
        StorageFull: If less is free.
    """
    disk = shutil.disk_usage(folder)
    kept_free = _kept_free(disk.total)
    if disk.free < kept_free + size_bytes:
        raise StorageFull(
            f"{what} needs {size_bytes} bytes; the disk has {disk.free} left, {kept_free} are kept"
            " free of uploads"
        )


def free_for_scans_bytes(folder: Path) -> int:
    """Return how many bytes scans may still take on the disk of a folder."""
    disk = shutil.disk_usage(folder)
    return max(disk.free - _kept_for_catalog(disk.total), 0)


def require_free_for_scans(folder: Path, size_bytes: int) -> None:
    """Reject scans that would take the space which the catalog needs to delete something.

    Raises:
        StorageFull: If less is free.
    """
    disk = shutil.disk_usage(folder)
    kept_free = _kept_for_catalog(disk.total)
    if disk.free < kept_free + size_bytes:
        raise StorageFull(
            f"no space is left for {size_bytes} bytes of scans: the disk has {disk.free} left,"
            f" {kept_free} are kept free for the catalog; free some, or raise the quota"
        )


def _kept_for_catalog(total_bytes: int) -> int:
    return min(total_bytes // 50, _KEPT_FOR_CATALOG_BYTES)


def _kept_free(total_bytes: int) -> int:
    return min(total_bytes // 20, _KEPT_FREE_BYTES)
