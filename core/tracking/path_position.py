"""Where a tracked vehicle is on the path between two scans of the map."""

import numpy as np

from core.arrays import FloatArray
from core.confidence.places import AWAY_M
from core.localization.match import Match
from core.scans.trajectory import Trajectory

_ESTIMATE_SIGMA_M = 0.3  # of a pose's estimate along the path, where it is good
_HALF_WAY = 0.5


def with_estimate(
    position: float, match: Match, trajectory: Trajectory, row_variance_m2: float
) -> float:
    """Return the position of a belief with what the estimated pose at its scan says.

    A belief is of scans, of which each is the path half-way to its neighbours. Where scans are far
    apart it hardly says where on that path the vehicle is, and the estimated pose does; where they
    are near each other it is the more exact one. Both are weighted by their variances.

    Measurements: docs/reference/tracking-measurements.md.

    Args:
        position: The mean of the belief, in rows.
        match: The scan at that position, and the query's estimated pose.
        trajectory: The map's.
        row_variance_m2: The variance of a vehicle that is anywhere on this scan's part of the path.

    Returns:
        The position in rows; the given one where no pose is estimated, and in a stand, which has no
        length.
    """
    pose = match.estimated_pose
    first, last = trajectory.stands[match.row].tolist()
    if pose is None or first < last:
        return position
    to_pose_m = np.array([pose.x_m, pose.y_m]) - trajectory.poses[match.row, :2]
    believed = position - match.row
    ahead = _rows_ahead(to_pose_m, believed, match, trajectory)
    if ahead is None:
        return position
    weight = row_variance_m2 / (row_variance_m2 + _ESTIMATE_SIGMA_M**2)
    return position + weight * (ahead - believed)


def _rows_ahead(
    to_pose_m: FloatArray, believed: float, match: Match, trajectory: Trajectory
) -> float | None:
    """Return how many rows ahead of its scan a pose is, negative towards the scan before it.

    At most half-way. Where the drive turns back, of both sides the one where it is believed to be.
    `None` if it is towards neither, and one of them is of an unknown pose or so far away that it is
    another place: no estimate reaches towards such a scan.
    """
    of_drive = trajectory.rows_of(match.drive)
    found, reaches = [], True
    for step in (1, -1):
        beside = match.row + step
        if not of_drive.start <= beside < of_drive.stop:
            continue
        way_m = trajectory.poses[beside, :2] - trajectory.poses[match.row, :2]
        squared_m2 = float(way_m @ way_m)
        if not 0.0 < squared_m2 <= AWAY_M**2:
            reaches = False
            continue
        share = float(way_m @ to_pose_m) / squared_m2
        if share > 0.0:
            found.append(step * min(share, _HALF_WAY))
    if not found:
        return 0.0 if reaches else None
    return min(found, key=lambda ahead: abs(ahead - believed))
