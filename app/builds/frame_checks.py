"""The check of world frames in a build: drives that were found in one frame stay so."""

import hashlib
from collections.abc import Collection, Mapping

from core.frames.agreement import check_frames, require_one_frame
from core.mapping.tensormap import TensorMap
from core.progress import Progress
from core.scans.trajectory import Trajectory


def require_frames(
    tensor_map: TensorMap,
    frameless: Collection[str],
    confirmed: Mapping[str, str],
    progress: Progress,
) -> tuple[tuple[str, ...], dict[str, str]]:
    """Require that the drives of a map are in one world frame.

    Drives with the poses that an earlier map confirmed are in one frame whatever else changed, and
    only the others are matched: a drive that is added to many costs what it has, not their square.

    Args:
        tensor_map: The map.
        frameless: Names of drives whose poses are odometry, in a frame of their own.
        confirmed: What this returned for a map before, none where there is none.
        progress: Receives every scan that is matched.

    Returns:
        A note on each drive that could not be checked, and by drive the digest of the poses of
        those in one frame.

    Raises:
        FramesDisagree: If a drive is in another one.
    """
    of_poses = _pose_digests(tensor_map.trajectory)
    same = {name for name, digest in confirmed.items() if of_poses.get(name) == digest}
    checks = check_frames(tensor_map, progress, frameless=frameless, confirmed=same)
    notes = require_one_frame(checks)
    unsure = {*frameless, *(check.drive for check in checks if not check.met)}
    return notes, {name: digest for name, digest in of_poses.items() if name not in unsure}


def _pose_digests(trajectory: Trajectory) -> dict[str, str]:
    """Return the digest of the poses of each drive, as they are in the map."""
    starts = trajectory.drive_start.tolist()
    return {
        name: hashlib.sha256(trajectory.poses[first:end].astype("<f8").tobytes()).hexdigest()
        for name, first, end in zip(trajectory.drives, starts[:-1], starts[1:], strict=True)
    }
