"""Lengths along the path of a vehicle, without the jitter of its poses while it is stationary."""

import math

import numpy as np

from core.arrays import FloatArray
from core.scans.pose import is_known

_PIECE_M = 1.0  # more than the jitter of a stationary vehicle's poses
_JITTER = 1.5  # times a piece's chord; a right angle is 1.4


def path_steps_m(positions_m: FloatArray) -> FloatArray:
    """Return the way from each of `(n, 3)` positions to the next, `(n - 1,)` metres.

    The path is cut into pieces that end a metre from where they begin. Steps are as long as they
    are, but where those of a piece are together far longer than the piece: it jitters about one
    place, and they are shortened to the piece's length.

    Examples:
        >>> stop = np.array([0.0, 1.5, 1.6, 1.4, 1.6, 1.4, 1.6, 1.4, 1.5, 3.0])
        >>> steps_m = path_steps_m(np.column_stack([stop, 0.0 * stop, 0.0 * stop]))
        >>> float(steps_m.sum().round(6)), float(steps_m[0])
        (3.0, 1.5)
    """
    steps_m = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    if (steps_m >= _PIECE_M).all():
        return np.asarray(steps_m)
    ends, start_m = [0], positions_m[0].tolist()
    for row, here_m in enumerate(positions_m.tolist()):
        if math.dist(here_m, start_m) >= _PIECE_M:
            ends.append(row)
            start_m = here_m
    if ends[-1] < len(steps_m):
        ends.append(len(steps_m))
    driven_m = np.add.reduceat(steps_m, ends[:-1])
    chord_m = np.linalg.norm(np.diff(positions_m[ends], axis=0), axis=1)
    share = np.ones_like(chord_m)
    np.divide(chord_m, driven_m, out=share, where=driven_m > _JITTER * chord_m)
    return np.asarray(steps_m * np.repeat(share, np.diff(ends)))


def usual_step_m(steps_m: FloatArray) -> float:
    """Return the step by which half of a way is driven in shorter ones, NaN without any.

    A vehicle that stands records many steps of hardly any length: they are no part of the way.

    Args:
        steps_m: `(n,)`, NaN where unknown.

    Examples:
        >>> usual_step_m(np.array([0.0, 0.0, 0.0, 0.0, 1.0, np.nan, 2.0, 1.0, 1.0]))
        1.0
    """
    rising_m = np.sort(steps_m[~np.isnan(steps_m)])
    if not len(rising_m):
        return math.nan
    driven_m = np.cumsum(rising_m)
    return float(rising_m[np.searchsorted(driven_m, driven_m[-1] / 2.0)])


def arc_lengths_m(positions_m: FloatArray) -> FloatArray:
    """Return how far along the path through `(n, 3)` positions each is, `(n,)` metres."""
    return np.concatenate([[0.0], np.cumsum(path_steps_m(positions_m))])


def path_length_m(rows: FloatArray) -> float:
    """Return the length of the path through `(n, 7)` pose rows in metres, NaN if one is unknown."""
    if not is_known(rows).all():
        return math.nan
    return float(path_steps_m(rows[:, :3]).sum())
