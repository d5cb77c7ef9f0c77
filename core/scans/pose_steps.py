"""Steps between consecutive poses that no vehicle makes."""

import numpy as np

from core.arrays import FloatArray, IntArray
from core.scans.pose import is_known

MOST_SPEED_MPS = 70.0
"""250 km/h: faster than any road."""
MOST_STEP_M = 20.0
"""Least step that is one too many where times are unknown, if others are much shorter."""
_LEAST_JUMP_M = 5.0  # errors of poses a few milliseconds apart are no speed
_MORE = 10.0  # times the median step


def jumps(scan_index: IntArray, timestamp_s: FloatArray, poses: FloatArray) -> IntArray:
    """Return the indices of scans whose pose is too far from the one before.

    Where both times are known, farther than a vehicle at `MOST_SPEED_MPS` comes; else more than
    `MOST_STEP_M`, and ten times the usual step, for each index between them.

    Args:
        scan_index: `(n,)` rising.
        timestamp_s: `(n,)` seconds, NaN where unknown.
        poses: `(n, 7)`, NaN where unknown; these are passed over.

    Examples:
        >>> x = [0.0, 1.0, 2.0, 903.0, 904.0]
        >>> poses = np.array([[x, 0, 0, 0, 0, 0, 1] for x in x])
        >>> jumps(np.arange(5), np.arange(5) * 0.1, poses).tolist()
        [3]
        >>> jumps(np.arange(5), np.full(5, np.nan), poses).tolist()
        [3]
    """
    known = np.flatnonzero(is_known(poses))
    if len(known) < 2:
        return np.empty(0, np.int64)
    step_m = np.linalg.norm(np.diff(poses[known, :3], axis=0), axis=1)
    step_s = np.diff(timestamp_s[known])
    per_scan_m = step_m / np.maximum(1, np.diff(scan_index[known]))
    timed = step_s > 0.0
    with np.errstate(invalid="ignore"):
        too_fast = step_m > np.maximum(_LEAST_JUMP_M, MOST_SPEED_MPS * step_s)
    too_far = per_scan_m > max(MOST_STEP_M, _MORE * float(np.median(per_scan_m)))
    found: IntArray = scan_index[known[1:]][np.where(timed, too_fast, too_far)]
    return found


def usual_step(timestamp_s: FloatArray, poses: FloatArray) -> tuple[float, float]:
    """Return the median of the seconds, and of the metres, from each known pose to the next.

    Args:
        timestamp_s: `(n,)` seconds, NaN where unknown; these are passed over.
        poses: `(n, 7)`, NaN where unknown; these are passed over.

    Returns:
        Seconds and metres, NaN of fewer than two.

    Examples:
        >>> poses = np.array([[x, 0, 0, 0, 0, 0, 1] for x in (0.0, 1.0, 2.0, 4.0)])
        >>> usual_step(np.array([0.0, 0.1, 0.2, 0.3]), poses)
        (0.1, 1.0)
    """
    known = is_known(poses) & np.isfinite(timestamp_s)
    if np.count_nonzero(known) < 2:
        return np.nan, np.nan
    step_m = np.linalg.norm(np.diff(poses[known, :3], axis=0), axis=1)
    return float(np.median(np.diff(timestamp_s[known]))), float(np.median(step_m))
