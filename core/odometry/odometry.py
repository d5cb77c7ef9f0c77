"""From the scans of a drive to its poses."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.arrays import FloatArray
from core.errors import EmptyDrive
from core.odometry.closures import find_closures
from core.odometry.level_frame import level_frame
from core.odometry.pose_graph import adjust
from core.odometry.registration import LIBRARY, RegistrationParameters, library_version
from core.odometry.scan_matching import match_scans
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive, scan_index_of
from core.scans.path import arc_lengths_m
from core.scans.pose import UNKNOWN_POSE, is_known, rows_from_matrices
from core.scans.sampling import spread_evenly

VERSION = 4
"""Version of all but the registration: poses of another version may differ."""
_GROUNDS = 25  # scans in which the ground below the sensor is looked for
_NAMED = 5  # scans that do not fit those before them, in the facts


@dataclass(frozen=True, eq=False)
class Odometry:
    """Poses of a drive by odometry.

    The world is level where the drive begins, with the first scan at its origin.

    Attributes:
        poses: `(K, 7)` pose rows of the sensor, NaN of scans that cannot be used.
        unclosed: `(K, 7)` the same before loops were closed.
        sigmas: `(K, 2)` standard deviations against the first scan: of x and y each, metres, and of
            the heading, degrees.
        lost: Positions of scans that do not fit those before them: a jump, or too few returns.
        facts: How they were computed, in plain values.
    """

    poses: FloatArray
    unclosed: FloatArray
    sigmas: FloatArray
    lost: tuple[int, ...]
    facts: Mapping[str, Any]

    @property
    def fitting(self) -> int:
        """Number of scans that can be used and fit those before them; the first one counts."""
        return int(is_known(self.poses).sum()) - len(self.lost)

    @property
    def usable(self) -> bool:
        """Whether at least half of the scans fit those before them, and not only the first one."""
        return self.fitting >= max(min(2, len(self.poses)), len(self.poses) / 2)


def compute_odometry(
    drive: Drive,
    sensor_height_m: float,
    progress: Progress = NO_PROGRESS,
    parameters: RegistrationParameters | None = None,
) -> Odometry:
    """Compute the poses of a drive from its scans.

    Args:
        drive: The drive as its sensor recorded it; poses that it has are not used.
        sensor_height_m: Above ground, about.
        progress: Receives every scan that is registered, projected or searched for.
        parameters: The registration's parameters.

    Raises:
        EmptyDrive: If the drive has no scan.
        ModuleNotFoundError: If KISS-ICP is not installed.
    """
    if not len(drive):
        raise EmptyDrive(f"drive {drive.name} has no scan")
    parameters = parameters or RegistrationParameters()
    matched = match_scans(drive, parameters, sensor_height_m, progress)
    grounds = spread_evenly(np.arange(len(drive)), _GROUNDS)
    levelling = level_frame(drive, grounds, sensor_height_m)
    closures = find_closures(
        drive,
        matched.poses,
        matched.usable,
        levelling,
        parameters,
        sensor_height_m,
        progress,
    )
    adjusted = adjust(matched.poses, matched.registered | ~matched.usable, closures)
    rows, unclosed = (
        rows_from_matrices(levelling @ poses) for poses in (adjusted.poses, matched.poses)
    )
    rows[~matched.usable] = unclosed[~matched.usable] = UNKNOWN_POSE
    sigmas = np.where(matched.usable[:, None], adjusted.sigmas, np.nan)
    lost = np.flatnonzero(matched.usable & ~matched.registered)
    return Odometry(
        rows,
        unclosed,
        sigmas,
        tuple(lost.tolist()),
        {
            "version": VERSION,
            "registration": f"{LIBRARY} {library_version()}",
            "parameters": {**parameters.as_json(), "sensor_height_m": sensor_height_m},
            "path_m": round(float(arc_lengths_m(adjusted.poses[:, :3, 3])[-1]), 1),
            "sigma_m": round(float(adjusted.sigmas[:, 0].max()), 2),
            "closures": int(adjusted.kept.sum()),
            "closures_rejected": int((~adjusted.kept).sum()),
            "lost": len(lost),
            "lost_scans": scan_index_of(drive)[lost[:_NAMED]].tolist(),
        },
    )
