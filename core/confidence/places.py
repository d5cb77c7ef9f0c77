"""Scans that were recorded away from, or close to, a scan of the map."""

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.scans.sampling import spread_evenly
from core.scans.trajectory import Trajectory

AWAY_M = 10.0
"""A runner-up is at least this far from the best match; nearer scans only confirm it."""
AWAY_SCANS = 50
"""The same where poses are unknown, in scans of one drive (5 s at 10 Hz)."""
_ELSEWHERE_M, _ELSEWHERE_SCANS = 25.0, 50  # a negative's: docs/explanation/trust.md
CLOSE_SCANS = 64
"""How many scans around a best match are compared to estimate its spread along the path."""


def away_from(
    trajectory: Trajectory, row: int, metres: float = AWAY_M, scans: int = AWAY_SCANS
) -> BoolArray:
    """Return which scans are away from scan `row`, `(K,)`.

    Those at least `metres` from it; where a pose is unknown those at least `scans` from it in its
    drive, and all of other drives.
    """
    if trajectory.all_known:
        return trajectory.apart_m(row) >= metres
    index, drive, known = trajectory.scan_index, trajectory.drive_of_scan, trajectory.known
    by_scans: BoolArray = (drive != drive[row]) | (np.abs(index - index[row]) >= scans)
    if not known[row]:
        return by_scans
    return np.where(known, trajectory.apart_m(row) >= metres, by_scans)


def elsewhere_from(trajectory: Trajectory, row: int) -> BoolArray:
    """Return which scans are so far from scan `row` that any match there is wrong, `(K,)`."""
    away = away_from(trajectory, row, _ELSEWHERE_M, _ELSEWHERE_SCANS)
    return away & comparable_with(trajectory, row)


def comparable_with(trajectory: Trajectory, row: int) -> BoolArray:
    """Return from which scans it is known how far scan `row` is, `(K,)`.

    Those of its drive, and those with a pose if it has one: a drive without poses may pass the
    streets of the others. Where no scan has a pose and its drive has none elsewhere, because it is
    short, other drives count as elsewhere.
    """
    known, drive, index = trajectory.known, trajectory.drive_of_scan, trajectory.scan_index
    if trajectory.all_known:
        return known
    own = drive == drive[row]
    if not known.any() and np.abs(index[own] - index[row]).max() < _ELSEWHERE_SCANS:
        return np.ones(len(trajectory), dtype=np.bool_)
    return np.asarray(own | (known & known[row]))


def close_along_m(
    trajectory: Trajectory, row: int, away: BoolArray | None = None
) -> tuple[IntArray, FloatArray] | None:
    """Return the scans within `AWAY_M` of scan `row` and how far ahead of it each was recorded.

    At most `CLOSE_SCANS` of them, evenly spread, and `row` itself: a stationary vehicle records
    hundreds.

    Args:
        trajectory: The map's trajectory.
        row: The scan's.
        away: `away_from` that row, if it is known.

    Returns:
        `(n,)` rows, rising, and `(n,)` metres along the heading of scan `row`; `None` where its
        pose is unknown.
    """
    if not trajectory.known[row]:
        return None
    away = away_from(trajectory, row) if away is None else away
    rows = np.flatnonzero(trajectory.known & ~away)
    if len(rows) > CLOSE_SCANS:
        rows = np.union1d(spread_evenly(rows, CLOSE_SCANS), row)
    ahead = np.radians(trajectory.headings_deg[row])
    offset_m = trajectory.poses[rows, :2] - trajectory.poses[row, :2]
    return rows, offset_m @ np.array([np.cos(ahead), np.sin(ahead)])
