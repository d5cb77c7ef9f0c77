"""Scans that wait for others, to be stored together in one drive."""

from collections.abc import Sequence
from typing import Generic, TypeVar

from core.scans.scan import Scan
from storage.files.drive_chunks import BYTES_PER_RETURN
from storage.store import Drives, PutResult

T = TypeVar("T")

# Making a small scan durable costs more than writing it: scans are stored in groups.
_GROUP_BYTES, _GROUP_SCANS = 4 * 2**20, 256


class ScanGroup(Generic[T]):
    """The scans of one upload, in groups; each is stored in the drive that got the first ones.

    Attributes:
        drive_id: Id of that drive; `None` before, for any.
    """

    def __init__(self) -> None:
        self._items: list[T] = []
        self._size_bytes = 0
        self.drive_id: str | None = None

    def add(self, item: T, scan: Scan) -> bool:
        """Add what has a scan; return whether there are enough of them to be stored."""
        self._items.append(item)
        self._size_bytes += len(scan) * BYTES_PER_RETURN
        return self._size_bytes >= _GROUP_BYTES or len(self._items) >= _GROUP_SCANS

    def take(self) -> Sequence[T]:
        """Return what waits, to be stored; nothing waits any more."""
        items, self._items, self._size_bytes = self._items, [], 0
        return items

    def put(
        self, drives: Drives, map_slug: str, drive_slug: str, scans: Sequence[tuple[int, Scan]]
    ) -> list[PutResult]:
        """Store scans; see `Drives.put_scans`.

        Raises:
            DriveNotFound: If the drive that got the first ones was deleted meanwhile.
            TensorMapError: What `Drives.put_scans` raises.
        """
        results = drives.put_scans(map_slug, drive_slug, scans, drive_id=self.drive_id)
        self.drive_id = next((result.drive_id for result in results), self.drive_id)
        return results
