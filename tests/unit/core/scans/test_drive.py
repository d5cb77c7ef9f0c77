"""Drives in memory."""

import numpy as np
import pytest

from core.scans.drive import MemoryDrive
from core.scans.pose import (
    Pose,
    is_known,
)
from core.scans.scan import Scan

POINTS = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], dtype=np.float32)


def test_a_drive_in_memory_gives_its_scans_in_order():
    drive = MemoryDrive("d", [Scan(POINTS, timestamp_s=1.0), Scan(POINTS, pose=Pose(1, 2, 3))])
    assert len(drive) == len(list(drive)) == 2
    np.testing.assert_array_equal(drive.timestamp_s, [1.0, np.nan])
    assert is_known(drive.poses).tolist() == [False, True]
    assert drive.scan(1).pose == Pose(1, 2, 3)
    for index in (-1, 2):
        with pytest.raises(IndexError):
            drive.scan(index)
