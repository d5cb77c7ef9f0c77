"""Some scans of a drive, as a drive."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.scans.drive import Drive, scan_index_of
from core.scans.pose import Pose
from core.scans.scan import Scan


@dataclass(frozen=True, eq=False)
class SelectedScans:
    """Some scans of a drive, as a drive; an `IndexedDrive`.

    Attributes:
        drive: The drive.
        scans: `(n,)` their positions in it, rising.
        planar: Whether heights are dropped: z is 0 in all poses.
    """

    drive: Drive
    scans: IntArray
    planar: bool = False

    @property
    def name(self) -> str:
        """The drive's name."""
        return self.drive.name

    @property
    def scan_index(self) -> IntArray:
        """`(n,)` the numbers that the drive gives them."""
        return np.asarray(scan_index_of(self.drive)[self.scans])

    @property
    def timestamp_s(self) -> FloatArray:
        """`(n,)` seconds, NaN where unknown."""
        return np.asarray(self.drive.timestamp_s[self.scans])

    @cached_property
    def poses(self) -> FloatArray:
        """`(n, 7)` pose rows."""
        rows = np.array(self.drive.poses[self.scans])
        if self.planar:
            rows[:, 2] = 0.0
        return rows

    def __len__(self) -> int:
        return len(self.scans)

    def scan(self, index: int) -> Scan:
        """Read scan `index`, 0-based.

        Raises:
            InvalidScan: If the recorded scan cannot be used.
        """
        scan = self.drive.scan(int(self.scans[index]))
        return replace(scan, pose=Pose.from_row(self.poses[index])) if self.planar else scan

    def only(self, which: BoolArray | IntArray) -> "SelectedScans":
        """Return some of these scans."""
        return SelectedScans(self.drive, self.scans[which], self.planar)

    def apart(self, metres: float) -> "SelectedScans":
        """Return the first scan and then each at least so far from the last one returned."""
        positions = self.poses[:, :3]
        kept: list[int] = []
        for scan, position in enumerate(positions):
            if not kept or np.linalg.norm(position - positions[kept[-1]]) >= metres:
                kept.append(scan)
        return self.only(np.array(kept, dtype=np.int64))


def as_recorded(drive: Drive, scans: IntArray) -> tuple[Drive, IntArray]:
    """Return the whole drive of which a drive may be a selection, and where its scans are in it.

    Two neighbours of a selection may have been recorded far apart; those of a whole drive were not.

    Args:
        drive: The drive.
        scans: `(n,)` positions in it.
    """
    while isinstance(drive, SelectedScans):
        scans = drive.scans[scans]
        drive = drive.drive
    return drive, scans
