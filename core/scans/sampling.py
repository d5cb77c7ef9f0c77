"""Samples of the scans of a drive."""

import numpy as np

from core.arrays import IntArray


def spread_evenly(scans: IntArray, at_most: int) -> IntArray:
    """Return at most so many of some scans, evenly spread, with the first and the last.

    Examples:
        >>> spread_evenly(np.arange(10), 4).tolist()
        [0, 3, 6, 9]
    """
    if len(scans) <= at_most:
        return scans
    return scans[np.linspace(0, len(scans) - 1, at_most).round().astype(np.int64)]
