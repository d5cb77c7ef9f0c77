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
        The position in rows; the given one where no pose is estimated, and in a stand, which is no
        way.
    """
    pose = match.estimated_pose
    first, last = trajectory.stands[match.row].tolist()
    if pose is None or first < last:
        return position
    to_pose_m = np.array([pose.x_m, pose.y_m]) - trajectory.poses[match.row, :2]
    estimated = match.row + _rows_ahead(to_pose_m, match, trajectory)
    weight = row_variance_m2 / (row_variance_m2 + _ESTIMATE_SIGMA_M**2)
    return position + weight * (estimated - position)


def _rows_ahead(to_pose_m: FloatArray, match: Match, trajectory: Trajectory) -> float:
    """Return how far a pose is towards the next scan or, below 0, towards the one before.

    At most half-way, and not towards a scan that is another place, as after an interruption.
    """
    of_drive = trajectory.rows_of(match.drive)
    ahead = 0.0
    for step in (1, -1):
        beside = match.row + step
        if not of_drive.start <= beside < of_drive.stop:
            continue
        way_m = trajectory.poses[beside, :2] - trajectory.poses[match.row, :2]
        squared_m2 = float(way_m @ way_m)
        if not 0.0 < squared_m2 <= AWAY_M**2:  # nor if it is unknown
            continue
        share = min(float(way_m @ to_pose_m) / squared_m2, _HALF_WAY)
        if share > abs(ahead):
            ahead = step * share
    return ahead
