"""Locks of drives, for work that needs their scans to stay as they are."""

import asyncio
from weakref import WeakValueDictionary


class DriveLocks:
    """A lock for each drive, as long as it is in use; of one event loop.

    One process serves a data directory, so no lock of the catalog is needed; what else counts on
    that is listed in docs/decisions/0034-tracks-outlast-a-process.md.

    Examples:
        >>> locks = DriveLocks()
        >>> lock = locks.of("4f1c", "monday")
        >>> lock is locks.of("4f1c", "monday"), lock is locks.of("4f1c", "tuesday")
        (True, False)
    """

    def __init__(self) -> None:
        self._locks = WeakValueDictionary[tuple[str, str], asyncio.Lock]()

    def of(self, map_id: str, drive_slug: str) -> asyncio.Lock:
        """Return the lock of a drive; it need not exist yet."""
        return self._locks.setdefault((map_id, drive_slug), asyncio.Lock())
