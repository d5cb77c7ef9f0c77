"""Where a query stands between the scans and renderings that it resembles."""

from dataclasses import dataclass

import numpy as np

from core.arrays import IntArray
from core.encodings.base import Found
from core.encodings.harmonic import HarmonicSearch
from core.scans.angles import wrapped_deg
from core.scans.displacement import left_of_m, places_beside_m, pose_beside
from core.scans.pose import Pose, heading_deg
from core.scans.trajectory import Trajectory

__all__ = ["Estimate", "estimate"]

_SHARPNESS = 8  # weights are the inverse distance to this power: docs/decisions/0010
_SCANS_BESIDE = 1  # before and after the match; farther ones weigh next to nothing
_SAME_PLACE_M = 10.0  # a drive that was interrupted goes on elsewhere
_SAME_TURN_DEG = 20.0  # a rendering that is turned otherwise resembles the query by accident


@dataclass(frozen=True)
class Estimate:
    """How a query stands to the scan that it matched, finer than the map's scans are.

    Attributes:
        turn_deg: How far it is turned from that scan, counter-clockwise, -180..180; `None` where
            the encoding does not tell.
        lateral_m: How far to the left of it, negative right.
        pose: Where it stands in the world, `None` where the scan's pose is unknown.
    """

    turn_deg: float | None
    lateral_m: float
    pose: Pose | None


def estimate(search: HarmonicSearch, trajectory: Trajectory, found: Found) -> Estimate:
    """Weigh the renderings of a matched scan and of the scans beside it by their likeness.

    A query lies between renderings (1.5 m apart) and scans (a metre or two). The mean over those
    that it resembles, weighted by (d_best / d)^8, lies between them too. Without poses only the
    matched scan's own renderings are weighed.

    Args:
        search: The query's search.
        trajectory: Of the map.
        found: A match of that search.
    """
    poses = trajectory.poses
    known = bool(trajectory.known[found.row])
    rows = _rows_beside(trajectory, found.row) if known else np.array([found.row])
    distances, turns_deg = search.exact(rows)
    if found.turn_deg is None:  # the encoding does not tell turns
        aside_deg = np.zeros_like(turns_deg)
    elif known:
        headings_deg = heading_deg(poses[rows]) - heading_deg(poses[[found.row]])
        aside_deg = wrapped_deg(turns_deg + headings_deg[:, None] - found.turn_deg)
    else:
        aside_deg = wrapped_deg(turns_deg - found.turn_deg)
    nearest = max(found.distance, float(np.finfo(np.float32).tiny))
    weights = (nearest / np.maximum(distances, nearest)) ** _SHARPNESS
    weights *= np.abs(aside_deg) <= _SAME_TURN_DEG
    weights /= weights.sum()
    turn_deg = None
    if found.turn_deg is not None:
        turn_deg = found.turn_deg + float(np.sum(weights * aside_deg))
        turn_deg = wrapped_deg(turn_deg)
    offsets_m = search.lateral_offset_m
    if not known:
        return Estimate(turn_deg, float(np.sum(weights @ offsets_m)), None)
    seen_from_m = places_beside_m(poses[rows], offsets_m)
    stands = pose_beside(poses[found.row], 0.0, turn_deg or 0.0)
    stands[:3] = np.einsum("kd,kdx->x", weights, seen_from_m)
    return Estimate(turn_deg, left_of_m(poses[found.row], stands), Pose.from_row(stands))


def _rows_beside(trajectory: Trajectory, row: int) -> IntArray:
    """Return the rows of a drive around `row` that were recorded near it, itself included."""
    rows = np.arange(max(0, row - _SCANS_BESIDE), min(len(trajectory), row + _SCANS_BESIDE + 1))
    apart_m = np.linalg.norm(trajectory.poses[rows, :3] - trajectory.poses[row, :3], axis=1)
    same_drive = trajectory.drive_of_scan[rows] == trajectory.drive_of_scan[row]
    near = same_drive & (apart_m <= _SAME_PLACE_M)  # a distance to the unknown, NaN, is not
    return np.asarray(rows[near])
