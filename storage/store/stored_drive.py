"""A drive in the store, as core reads it."""

from collections.abc import Callable, Sequence

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray, frozen
from core.scans.pose import pose_rows
from core.scans.scan import Scan
from storage.catalog import DriveRecord, ScanPoses, ScanRecord


class StoredDrive:
    """The scans that a drive had when it was opened; satisfies `core.scans.drive.Drive`.

    Position i is the i-th scan in the order of the indices, without gaps: positions are 0, 1, 2
    where the drive has scans 0, 5, 6.

    Attributes:
        record: What the catalog had of the drive.
        id: The drive's id; a new drive under the same slug has another.
        map_id: The id of its map.
        name: The drive's slug.
        scan_index: `(K,)` the index under which each scan is stored.
        timestamp_s: `(K,)` seconds, NaN where unknown.
        poses: `(K, 7)` pose rows, sensor to world, NaN where unknown.
        digests: `K` SHA-256 digests of the scans' returns.
        mounting: The mounting of its sensor, `None` if the vehicle's frame is the sensor's.
        accumulate: How many consecutive scans become one of a map.
        has_returns: `(K,)` whether a scan's returns are still stored.
        odometry: How its poses were computed, `None` if they were given.
        pose_source: Where the drive's poses come from.
        pose_check: How given poses agree with the scans, `None` if not checked.
    """

    def __init__(
        self, drive: DriveRecord, records: Sequence[ScanRecord], read: Callable[[int], Scan]
    ) -> None:
        self.record = drive
        self.id, self.map_id, self.name = drive.id, drive.map_id, drive.slug
        self.scan_index: IntArray = frozen([r.index for r in records], np.int64)
        self.timestamp_s: FloatArray = frozen([r.timestamp_s for r in records], np.float64)
        self.poses: FloatArray = frozen(pose_rows([r.pose for r in records]), np.float64)
        self.digests = tuple(record.digest for record in records)
        self.mounting, self.accumulate = drive.mounting, drive.accumulate
        self.odometry, self.pose_source = drive.odometry, drive.pose_source
        self.pose_check = drive.pose_check
        self.has_returns: BoolArray = frozen([r.has_returns for r in records], np.bool_)
        self._read = read

    def __len__(self) -> int:
        return len(self.scan_index)

    @property
    def scan_poses(self) -> ScanPoses:
        """The poses and times of its scans as the catalog takes them."""
        return ScanPoses(self.scan_index, self.poses, self.timestamp_s)

    def scan(self, index: int) -> Scan:
        """Read the scan at position `index`.

        Raises:
            ScanNotFound: If the drive was deleted meanwhile.
            ReturnsGone: If its returns were dropped after a build.
            CorruptFile: If the stored scan is not the one that was put.
        """
        return self._read(int(self.scan_index[index]))
