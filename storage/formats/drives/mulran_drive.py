"""Drives in the layout of MulRan: `sensor_data/Ouster/<ns>.bin` and `global_pose.csv`.

Kim, Park, Cho, Jeong and Kim, "MulRan: multimodal range dataset for urban place recognition",
ICRA 2020. Scans are float32 records x y z intensity of an OS1-64. The ground truth has a line for
each pose of the vehicle: nanoseconds since 1970 and the 3 x 4 matrix [R | t], row by row, in UTM
(x east, y north, z up). The Ouster is on the vehicle, x forward, y left, z up, at (1.7042, -0.021,
1.8047) m with roll, pitch and yaw 0.0001, 0.0003 and 179.6654 degrees: its x axis looks back. The
points keep the sensor's frame, and the pose is the sensor's.

Verified: the fields and the six numbers, in independent public code for this data set. That they
are the sensor's pose on the vehicle, and not the inverse, follows from the height: not verified for
lack of an original recording.
"""

from pathlib import Path

import numpy as np

from core.arrays import FloatArray
from storage.formats.drives.file_drive import FileDrive
from storage.formats.drives.timed_poses import (
    TimedPoses,
    open_stamped_drive,
    read_timed_poses,
    timed_poses,
)

FOLDERS = ("sensor_data/Ouster", "Ouster")
"""Where the scans may be: as published, and as the field's scripts unpack them."""
_OUSTER_M = (1.7042, -0.021, 1.8047)
_OUSTER_DEG = (0.0001, 0.0003, 179.6654)
_COLUMNS = 13


def open_mulran_drive(path: Path, *, min_returns: int = 1) -> FileDrive:
    """Open a drive of `sensor_data/Ouster/*.bin` or `Ouster/*.bin`; `global_pose.csv` is optional.

    Args:
        path: The folder of the sequence, or its `sensor_data`.
        min_returns: Least number of returns of a scan.

    Raises:
        EmptyDrive: If there are no scans.
        MalformedDrive: If a scan is not named by its time, or the poses do not parse or are of
            another drive.
    """
    path = path.resolve()
    path = path.parent if path.name == "sensor_data" else path
    folder = next(path / folder for folder in FOLDERS if (path / folder).is_dir())
    file = path / "global_pose.csv"
    poses = _read(file) if file.exists() else None
    return open_stamped_drive(path.name, folder, poses, min_returns=min_returns)


def _read(file: Path) -> TimedPoses:
    time_s, numbers = read_timed_poses(file, columns=_COLUMNS, ticks_per_s=1e9, separator=",")
    vehicle = np.broadcast_to(np.eye(4), (len(numbers), 4, 4)).copy()
    vehicle[:, :3] = numbers.reshape(-1, 3, 4)
    return timed_poses(file, time_s, vehicle @ _ouster_on_vehicle())


def _ouster_on_vehicle() -> FloatArray:
    from scipy.spatial.transform import Rotation  # only such drives need it: decision 33

    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", _OUSTER_DEG, degrees=True).as_matrix()
    matrix[:3, 3] = _OUSTER_M
    return matrix
