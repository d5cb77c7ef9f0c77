"""A recorded drive that remembers what it read: builds without a store note equal scans too."""

from core.arrays import FloatArray, IntArray
from core.scans.drive import Drive, scan_index_of
from core.scans.scan import Scan
from storage.files.drive_chunks import scan_digest


class DigestedDrive:
    """A recorded drive that keeps the digests of its scans as they are read; an `IndexedDrive`.

    A build reads each scan once, so that no other reading is needed; satisfies `NotedDrive`.

    Args:
        drive: The recording.
    """

    def __init__(self, drive: Drive) -> None:
        self.name = drive.name
        self.timestamp_s: FloatArray = drive.timestamp_s
        self.poses: FloatArray = drive.poses
        self.scan_index: IntArray = scan_index_of(drive)
        self._drive = drive
        self._digests: dict[int, str] = {}

    def __len__(self) -> int:
        return len(self._drive)

    @property
    def digests(self) -> tuple[str, ...]:
        """A digest of each scan; one that was not read, or cannot be, is like no other."""
        unread = f"of {id(self)}"  # another drive may have the same name
        return tuple(self._digests.get(at, f"{at} {unread}") for at in range(len(self)))

    def scan(self, index: int) -> Scan:
        """Read scan `index`.

        Raises:
            InvalidScan: If the recorded scan cannot be used.
        """
        scan = self._drive.scan(index)
        if index not in self._digests:
            self._digests[index] = scan_digest(scan.points_m)
        return scan
