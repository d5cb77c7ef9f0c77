"""Where the mapping vehicle stood or crept: a minute at a red light is hundreds of scans."""

import math

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray

STAND_M = 0.4
"""Scans of a stand are as near its first one: more than poses of a vehicle that stands jitter."""

_FEW = 5  # scans on so short a way, at a walking pace and ten a second


def stands_of(poses: FloatArray) -> IntArray:
    """Return the first and last row of the stand to which each scan of a drive belongs, `(K, 2)`.

    A stand is more than five scans in a row within 0.4 m of its first one. A scan of a vehicle that
    drives is by itself.

    Args:
        poses: `(K, 7)` sensor to world, NaN where unknown.
    """
    rows, positions_m = np.arange(len(poses)), poses[:, :3]
    stands = np.stack([rows, rows], axis=1)
    apart_m = np.linalg.norm(positions_m[_FEW:] - positions_m[:-_FEW], axis=1)
    begins = np.flatnonzero(apart_m < STAND_M)
    if not len(begins):
        return stands
    places_m, end = positions_m.tolist(), 0
    for begin in begins.tolist():
        if begin < end:
            continue
        end = begin + 1
        while end < len(places_m) and math.dist(places_m[end], places_m[begin]) < STAND_M:
            end += 1
        if end - begin > _FEW:
            stands[begin:end] = begin, end - 1
        else:
            end = begin
    return stands


def first_of_stands(poses: FloatArray) -> BoolArray:
    """Return which scans of a drive count where a stand counts as one: the first of each, `(K,)`.

    Args:
        poses: `(K, 7)` sensor to world, NaN where unknown.
    """
    return np.asarray(stands_of(poses)[:, 0] == np.arange(len(poses)))


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
