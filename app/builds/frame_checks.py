"""What a build knows of world frames: drives that were found in one frame stay so."""

from collections.abc import Collection, Mapping
from typing import NamedTuple

from core.frames.agreement import check_frames, require_one_frame
from core.mapping.tensormap import TensorMap
from core.progress import Progress
from core.scans.pose import digest_of_poses
from core.scans.trajectory import Trajectory


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

    Drives that an earlier map confirmed are in one frame, and only the others are matched: a drive
    that is added to many costs what it has, not their square.

    Args:
        tensor_map: The map.
        frameless: Names of drives whose poses are odometry; these were aligned.
        confirmed: The `pose_digests` of a map whose drives were all in one frame.
        progress: Receives every scan that is matched.

    Raises:
        FramesDisagree: If a drive is in another one.
    """
    same = of_same_poses(tensor_map.trajectory, confirmed)
    checks = check_frames(tensor_map, progress, frameless=frameless, confirmed=same)
    notes = require_one_frame(checks)
    return CheckedFrames(notes, tuple(check.drive for check in checks if not check.met))


def pose_digests(trajectory: Trajectory) -> dict[str, str]:
    """Return the digest of the poses of each drive that has some, as they are in the map."""
    rows_of = {name: trajectory.rows_of(name) for name in trajectory.drives}
    return {
        name: digest_of_poses(trajectory.poses[rows])
        for name, rows in rows_of.items()
        if trajectory.known[rows].any()
    }


def of_same_poses(trajectory: Trajectory, confirmed: Mapping[str, str]) -> set[str]:
    """Return the confirmed drives of a map; none if one of them has other poses now.

    What was found with the old poses, of other drives too, is no longer there.
    """
    found = pose_digests(trajectory)
    there = {name for name in confirmed if name in trajectory.drives}
    return there if all(found.get(name) == confirmed[name] for name in there) else set()
