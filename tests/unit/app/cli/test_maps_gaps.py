"""Maps that commands build of folders in which scans are missing."""

import re

import numpy as np
import pytest

from core.scans.drive import MemoryDrive
from core.scans.scan import Scan
from storage.formats.drives.kitti_drive import write_kitti_drive
from tests.support.commands import notes_of
from tests.support.odometry import needs_odometry
from tests.support.recording import recording

SCANS = recording().scans


@needs_odometry
@pytest.mark.parametrize("numbers", [[*range(6), *range(12, 18)], [*range(18)]])
def test_missing_scan_files_are_a_gap_of_the_computed_poses(tmp_path, numbers):
    write_kitti_drive(
        MemoryDrive("street", [Scan(scan.points_m) for scan in SCANS[:18]]), tmp_path / "monday"
    )
    for number in {*range(18)} - {*numbers}:
        (tmp_path / "monday" / "velodyne" / f"{number:06d}.bin").unlink()
    said = notes_of("build", tmp_path / "monday", "-o", tmp_path / "map.h5", "--segments", "1")
    said = " ".join(said.split())
    [path_m] = re.findall(r"poses by odometry \([^)]*\) over ([\d.]+) m", said)
    assert float(path_m) == pytest.approx(_path_m(18), rel=0.03)
    assert "jump" not in said


def _path_m(scans):
    positions_m = np.array([recording().pose(at).as_tuple()[:3] for at in range(scans)])
    return float(np.linalg.norm(np.diff(positions_m, axis=0), axis=1).sum())
