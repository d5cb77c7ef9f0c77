"""Times of scans and observations: seconds, by any clock."""

import math

import numpy as np

from core.arrays import FloatArray, IntArray

LATEST_S = 1e11
"""Farthest from 0: since 1970 that is after the year 5000, and milliseconds are beyond it."""


def flaw_of_time(time_s: float) -> str | None:
    """Return what is wrong with a given time, `None` if nothing is.

    Examples:
        >>> flaw_of_time(1679000000.1) is None
        True
        >>> flaw_of_time(1679000000100000000)
        '1.6790000001e+18, wanted seconds, within 1e+11 of 0'
    """
    if math.isfinite(time_s) and abs(time_s) <= LATEST_S:
        return None
    return f"{float(time_s)!r}, wanted seconds, within {LATEST_S:g} of 0"


def first_flawed(timestamp_s: FloatArray) -> int | None:
    """Return the first row that is no time, `None` if each is one or unknown (not finite)."""
    flawed = np.isfinite(timestamp_s) & (np.abs(timestamp_s) > LATEST_S)
    return int(flawed.argmax()) if flawed.any() else None


def decreasing_rows(timestamp_s: FloatArray) -> IntArray:
    """Return the rows whose time is before that of the last row with one.

    Args:
        timestamp_s: `(n,)` seconds, NaN where unknown; these are passed over.

    Examples:
        >>> decreasing_rows(np.array([5.0, np.nan, 3.0, 3.0, 4.0])).tolist()
        [2]
    """
    known = np.flatnonzero(np.isfinite(timestamp_s))
    return np.asarray(known[1:][np.diff(timestamp_s[known]) < 0.0])
