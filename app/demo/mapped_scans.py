"""The scans of a drive that the demonstration maps, as they are uploaded."""

from pathlib import Path

import numpy as np
from tensormap_client import ScanBody, UnusableScan

from core.arrays import BoolArray
from core.errors import InvalidScan
from core.scans.drive import Drive
from storage.formats.scans.kitti import KittiFormat, kitti_body


class MappedScans:
    """The scans of a drive that are not held out; satisfies `Source`.

    Args:
        drive: The drive.
        held_out: The scans to localize, of the drive's first ones.

    Attributes:
        recorded: Indices in the drive of the scans that were sent, in their order.
        returns: How many returns these have.
    """

    beside: tuple[Path, ...] = ()

    def __init__(self, drive: Drive, held_out: BoolArray) -> None:
        self.name, self._drive = drive.name, drive
        self._mapped = np.flatnonzero(~held_out).tolist()
        self.recorded: list[int] = []
        self.returns = 0

    def __len__(self) -> int:
        return len(self._mapped)

    def scan_body(self, index: int) -> ScanBody:
        """Return a scan as it is sent."""
        try:
            scan = self._drive.scan(self._mapped[index])
        except InvalidScan as error:
            raise UnusableScan(str(error)) from error
        self.recorded.append(self._mapped[index])
        self.returns += len(scan)
        return ScanBody(
            index,
            kitti_body(scan),
            KittiFormat().media_type,
            scan.timestamp_s if np.isfinite(scan.timestamp_s) else None,
            None if scan.pose is None else scan.pose.as_tuple(),
        )
