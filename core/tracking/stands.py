"""Where the mapping vehicle stood or crept: a minute at a red light is hundreds of scans."""

import math

import numpy as np

from core.arrays import FloatArray, IntArray
from core.scans.trajectory import Trajectory

_WITHIN_M = 0.4  # of the first scan: more than poses jitter while a vehicle stands
_FEW = 5  # scans on so short a way, at a walking pace and ten a second


def stands_of(trajectory: Trajectory) -> IntArray:
    """Return the first and last row of the stand to which each scan belongs, `(K, 2)`.

    A stand is more than five scans in a row within 0.4 m of its first one. A scan of a vehicle that
    drives is by itself.
    """
    rows = np.arange(len(trajectory))
    stands = np.stack([rows, rows], axis=1)
    positions_m, drive = trajectory.poses[:, :3], trajectory.drive_of_scan
    apart_m = np.linalg.norm(positions_m[_FEW:] - positions_m[:-_FEW], axis=1)
    begins = np.flatnonzero((apart_m < _WITHIN_M) & (drive[_FEW:] == drive[:-_FEW]))
    if not len(begins):
        return stands
    places_m, end = positions_m.tolist(), 0
    for begin in begins.tolist():
        if begin < end:
            continue
        end, last = begin + 1, int(trajectory.drive_start[drive[begin] + 1])
        while end < last and math.dist(places_m[end], places_m[begin]) < _WITHIN_M:
            end += 1
        if end - begin > _FEW:
            stands[begin:end] = begin, end - 1
        else:
            end = begin
    return stands


def cuts_outside(stands: IntArray, cut_position: FloatArray) -> FloatArray:
    """Return where segments are cut, with a cut within a stand moved to its beginning.

    Args:
        stands: `(K, 2)` the first and last row of the stand of each scan.
        cut_position: `(L + 1,)` in fractions of rows, between -0.5 and K - 0.5.

    Examples:
        >>> stands = np.array([[0, 0], [1, 3], [1, 3], [1, 3], [4, 4]])
        >>> cuts_outside(stands, np.array([-0.5, 0.5, 1.5, 2.7, 3.5, 4.5])).tolist()
        [-0.5, 0.5, 0.5, 0.5, 3.5, 4.5]
    """
    first, last = stands[np.clip(np.floor(cut_position).astype(np.int64), 0, len(stands) - 1)].T
    within = (first < cut_position) & (cut_position < last)
    return np.where(within, first - 0.5, cut_position)
