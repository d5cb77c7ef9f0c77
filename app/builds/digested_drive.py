"""A recorded drive that remembers what it read: builds without a store note equal scans too."""

from dataclasses import dataclass

import numpy as np

from core.arrays import FloatArray, IntArray
from core.scans.drive import Drive, scan_index_of
from core.scans.scan import Scan
from storage.files.drive_chunks import scan_digest


@dataclass(frozen=True, eq=False)
class ReadScans:
    """The scans of a drive that were read; satisfies `NotedDrive`.

    Attributes:
        name: The drive's name.
        scan_index: `(n,)` the number of each, rising.
        digests: A digest of each one's returns.
    """

    name: str
    scan_index: IntArray
    digests: tuple[str, ...]


class DigestedDrive:
    """A recorded drive that keeps the digests of its scans as they are read; an `IndexedDrive`.

    A build reads each scan once, so that no other reading is needed.

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
    def read(self) -> ReadScans:
        """The scans that were read until now; an evaluation may read few of them."""
        rows = sorted(self._digests)
        digests = tuple(self._digests[row] for row in rows)
        return ReadScans(self.name, self.scan_index[np.array(rows, np.int64)], digests)

    def scan(self, index: int) -> Scan:
        """Read scan `index`.

        Raises:
            InvalidScan: If the recorded scan cannot be used.
        """
        scan = self._drive.scan(index)
        if index not in self._digests:
            self._digests[index] = scan_digest(scan.points_m)
        return scan
