"""What a build knows of world frames: drives that were found in one frame stay so."""

import hashlib
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np

from core.frames.agreement import check_frames, require_one_frame
from core.mapping.tensormap import TensorMap
from core.progress import Progress
from core.scans.trajectory import Trajectory

_DECIMALS = 6  # of poses: a transform that was stored and read changes the last digit


class CheckedFrames(NamedTuple):
    """A check of frames.

    Attributes:
        notes: A note on each drive that could not be checked.
        unsure: Names of these drives.
    """

    notes: tuple[str, ...]
    unsure: tuple[str, ...]


def require_frames(
    tensor_map: TensorMap,
    frameless: Collection[str],
    confirmed: Mapping[str, str],
    progress: Progress,
) -> CheckedFrames:
    """Require that the drives of a map are in one world frame.

    Drives with the poses that an earlier map confirmed are in one frame whatever else changed, and
    only the others are matched: a drive that is added to many costs what it has, not their square.

    Args:
        tensor_map: The map.
        frameless: Names of drives whose poses are odometry; these were aligned.
        confirmed: What `confirmed_frames` returned for a map before, none where there is none.
        progress: Receives every scan that is matched.

    Raises:
        FramesDisagree: If a drive is in another one.
    """
    same = of_same_poses(tensor_map.trajectory, confirmed)
    checks = check_frames(tensor_map, progress, frameless=frameless, confirmed=same)
    notes = require_one_frame(checks)
    return CheckedFrames(notes, tuple(check.drive for check in checks if not check.met))


def confirmed_frames(trajectory: Trajectory, unsure: Collection[str]) -> dict[str, str]:
    """Return the digest of the poses of each drive, as they are in the map, but of some."""
    starts = trajectory.drive_start.tolist()
    return {
        name: _digest(trajectory, first, end)
        for name, first, end in zip(trajectory.drives, starts[:-1], starts[1:], strict=True)
        if name not in unsure
    }


def of_same_poses(trajectory: Trajectory, confirmed: Mapping[str, str]) -> set[str]:
    """Return the confirmed drives that have the same poses in this map."""
    found = confirmed_frames(trajectory, ())
    return {name for name, digest in confirmed.items() if found.get(name) == digest}


def _digest(trajectory: Trajectory, first: int, end: int) -> str:
    poses = np.round(trajectory.poses[first:end], _DECIMALS) + 0.0  # no negative zero
    return hashlib.sha256(poses.astype("<f8").tobytes()).hexdigest()
