"""Odometry of a recorded drive without poses, as a part of its build, and what notes say."""

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from core.odometry.odometry import Odometry, compute_odometry
from core.odometry.posed_drive import PosedDrive
from core.odometry.registration import library_version
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive
from core.scans.pose import is_known
from core.text import verb_of

LEAST_SCANS = 2
_LEAST_PATH_M = 1.0  # of a drive; less may be noise of scans that show no motion
HAS_LIBRARY = sys.version_info < (3, 14)
"""Whether there is a release of KISS-ICP for this Python: pyproject.toml."""
WANTED = (
    "install the extra `odometry`, which computes missing poses: `pip install ./clients/python"
    " '.[odometry]'` in the clone of the service"
    if HAS_LIBRARY
    else "KISS-ICP, which computes missing poses, has no release for this Python yet"
)
MISSING = f"put poses, or {WANTED}" if HAS_LIBRARY else f"put poses: {WANTED}"


def pose_recorded(
    drive: Drive, sensor_height_m: float, progress: Progress = NO_PROGRESS
) -> tuple[Drive, tuple[str, ...]]:
    """Return a recorded drive, with computed poses if it has none, and notes on these.

    Args:
        drive: The drive as its sensor recorded it.
        sensor_height_m: Above ground.
        progress: Receives the stages.
    """
    if is_known(drive.poses).any() or len(drive) < LEAST_SCANS:
        return drive, ()
    if library_version() is None:
        return drive, (f"{unposed(drive)}: {MISSING}",)
    found = compute_odometry(drive, sensor_height_m, progress)
    if not found.usable:
        return drive, (failure_note(drive, found),)
    notes = (origin_note(drive.name, found.facts), *doubt_notes(drive.name, found.facts))
    return PosedDrive(drive, found.poses), notes


def origin_note(name: str, facts: Mapping[str, Any]) -> str:
    """Return the note on computed poses: by what, how far, and how exact."""
    text = (
        f"drive {name}: poses by odometry ({facts['registration']}) over {facts['path_m']:g} m,"
        f" with {facts['closures']} loop closures; standard deviation up to {facts['sigma_m']:g} m"
    )
    if facts["path_m"] >= _LEAST_PATH_M:
        return text
    return (
        f"{text}: the scans show hardly any motion: did the vehicle stand, or are they in the"
        " frame of a map, as clouds that SLAM has registered, and not in the sensor's?"
    )


def failure_note(drive: Drive, found: Odometry) -> str:
    """Return the note on a drive of which no poses could be computed."""
    lost = len(drive) - found.fitting
    return (
        f"{unposed(drive)}: odometry found none, {lost} of {len(drive)} scans do not fit those"
        " before them, or have too few returns"
    )


def unposed(drive: Drive) -> str:
    """Return how much of a drive has no pose, and what that means."""
    unknown = int(np.count_nonzero(~is_known(drive.poses)))
    if unknown == len(drive):
        return f"drive {drive.name} has no poses, everything is in scan indices, no metres"
    have = verb_of(unknown, "has", "have")
    return f"drive {drive.name}: {unknown} of {len(drive)} scans {have} no pose"


def doubt_notes(name: str, facts: Mapping[str, Any]) -> list[str]:
    """Return a note on scans that do not fit those before them, if there are any."""
    first = facts.get("lost_scans")  # earlier versions stored none
    if not first:
        return []
    where = f"{', '.join(map(str, first))}: is something missing? poses there are guesses"
    if facts["lost"] == 1:
        return [f"drive {name}: 1 scan does not fit that before it, {where}"]
    return [f"drive {name}: {facts['lost']} scans do not fit those before them, as {where}"]
