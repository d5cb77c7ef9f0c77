"""A drive with the poses that odometry computed."""

from dataclasses import replace

import numpy as np

from core.arrays import FloatArray, IntArray, frozen
from core.scans.drive import Drive, scan_index_of
from core.scans.pose import Pose
from core.scans.scan import Scan


class PosedDrive:
    """A drive with other poses; an `IndexedDrive`.

    Args:
        drive: The recording.
        poses: `(K, 7)` pose rows of the sensor, NaN where unknown.
    """

    def __init__(self, drive: Drive, poses: FloatArray) -> None:
        self.name, self.timestamp_s = drive.name, drive.timestamp_s
        self.scan_index: IntArray = scan_index_of(drive)
        self.poses: FloatArray = frozen(poses, np.float64)
        self._drive = drive

    def __len__(self) -> int:
        return len(self._drive)

    def scan(self, index: int) -> Scan:
        """Read scan `index`.

        Raises:
            InvalidScan: If the recorded scan cannot be used.
        """
        return replace(self._drive.scan(index), pose=Pose.from_row(self.poses[index]))
