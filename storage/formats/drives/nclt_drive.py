"""Drives in the layout of NCLT: `velodyne_sync/*.bin` and `groundtruth_<date>.csv`.

Carlevaris-Bianco, Ushani and Eustice, "University of Michigan North Campus long-term vision and
lidar dataset", IJRR 35 (2016). The ground truth has a line for each pose of the vehicle:
microseconds since 1970, x, y, z, roll r, pitch p, heading h, with R = Rz(h) Ry(p) Rx(r). Its world
is x north, y east, z down, its vehicle x forward, y right, z down. Here the world is x north, y
west, z up, and a pose is that of the lidar as `NcltFormat` reads its points: x forward, y left, z
up.
"""

from glob import escape
from pathlib import Path

import numpy as np

from core.arrays import FloatArray
from storage.formats.drives.file_drive import FileDrive, in_order
from storage.formats.drives.timed_poses import read_timed_poses, timed_poses
from storage.formats.drives.z_down import Z_DOWN_TO_Z_UP, matrices_of
from storage.formats.errors import MalformedDrive
from storage.formats.scans.records import NCLT_LIDAR_M, NcltFormat

_COLUMNS = 7


def open_nclt_drive(path: Path, *, min_returns: int = 1) -> FileDrive:
    """Open a drive of `velodyne_sync/*.bin`, named by microseconds.

    The ground truth is optional: `groundtruth*.csv` in the folder, in its `ground_truth/`, or, with
    the folder's name in its own, in `ground_truth/` beside it.

    Raises:
        EmptyDrive: If there are no scans.
        MalformedDrive: If the ground truth does not parse or is of another drive.
    """
    path = path.resolve()
    files = in_order((path / "velodyne_sync").glob("[!.]*.bin"))
    time_s = np.array([float(f.stem) / 1e6 if f.stem.isdecimal() else np.nan for f in files])
    rows = np.full((len(files), 7), np.nan)
    known, truth = np.isfinite(time_s), _ground_truth(path)
    if truth is not None and known.any():
        at_s, numbers = read_timed_poses(truth, columns=_COLUMNS, ticks_per_s=1e6, separator=",")
        rows[known] = timed_poses(truth, at_s, _lidar_poses(numbers)).at(time_s[known])
    return FileDrive(path.name, files, time_s, rows, min_returns, NcltFormat().media_type)


def _ground_truth(path: Path) -> Path | None:
    found = sorted(
        {
            *path.glob("groundtruth*.csv"),
            *path.glob("ground_truth/groundtruth*.csv"),
            *path.parent.glob(f"ground_truth/groundtruth_{escape(path.name)}.csv"),
        }
    )
    if len(found) > 1:
        raise MalformedDrive(
            f"{path} has several ground truths, wanted one: {', '.join(map(str, found))}"
        )
    return found[0] if found else None


def _lidar_poses(vehicle: FloatArray) -> FloatArray:
    """Return the `(n, 4, 4)` poses of the lidar, of `(n, 6)` x, y, z, roll, pitch, heading."""
    on_vehicle = Z_DOWN_TO_Z_UP.copy()
    on_vehicle[:3, 3] = NCLT_LIDAR_M
    return np.asarray(Z_DOWN_TO_Z_UP @ matrices_of(vehicle) @ on_vehicle)
