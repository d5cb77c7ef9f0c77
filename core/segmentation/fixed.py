"""Segments of one length (paper, sec. 2.2)."""

import itertools
import math

import numpy as np

from core.arrays import IntArray
from core.errors import EmptyDrive, InvalidParameters
from core.numbers import require_at_least, require_whole

PAPER_SEGMENT_LENGTH = 760  # k, sec. 3.2


def segment_length_for(
    scans: int, *, segment_length: int | None = None, segments: int | None = None
) -> int:
    """Return k for a drive of `scans` scans.

    With `segments`, L, k = ceil(K / L): a short drive may have fewer segments, and unequal segments
    may be more or fewer. Without either, k is the paper's 760: long segments are easier to
    distinguish than short ones.

    Raises:
        InvalidParameters: If both are given, or one is below 1 or no whole number.
    """
    if segment_length is not None and segments is not None:
        raise InvalidParameters("give segment_length or segments, not both")
    require_whole(segment_length=segment_length, segments=segments)
    require_at_least(1, segment_length=segment_length, segments=segments)
    if segment_length is not None:
        return segment_length
    if segments is not None:
        return max(1, math.ceil(scans / segments))
    return PAPER_SEGMENT_LENGTH


def cut_fixed(scans: int, segment_length: int) -> IntArray:
    """Cut `scans` scans into segments of `segment_length`, `(L + 1,)` starts and the end.

    The length need not divide K, as the paper assumes: a last segment shorter than half of it
    joins the one before.

    Raises:
        EmptyDrive: If there is no scan.
        InvalidParameters: If the length is below 1.

    Examples:
        >>> cut_fixed(11, 4).tolist(), cut_fixed(9, 4).tolist()
        ([0, 4, 8, 11], [0, 4, 9])
    """
    if scans < 1:
        raise EmptyDrive("there is no scan to cut into segments")
    require_at_least(1, segment_length=segment_length)
    starts = np.arange(0, scans, min(segment_length, scans), dtype=np.int64)
    if len(starts) > 1 and 2 * (scans - starts[-1]) < segment_length:
        starts = starts[:-1]
    return np.append(starts, np.int64(scans))


def cut_drives(drive_start: IntArray, segment_length: int) -> IntArray:
    """Cut every drive by itself, `(L + 1,)`: no segment runs from one drive into the next.

    Args:
        drive_start: `(D + 1,)` row of each drive's first scan, and K.
        segment_length: k, as in `cut_fixed`.

    Examples:
        >>> cut_drives(np.array([0, 4, 7]), 2).tolist()
        [0, 2, 4, 6, 7]
    """
    starts = drive_start.tolist()
    cuts = [
        start + cut_fixed(end - start, segment_length)[:-1]
        for start, end in itertools.pairwise(starts)
    ]
    return np.concatenate([*cuts, drive_start[-1:]])
