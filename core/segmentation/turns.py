"""Where a drive turns, by its poses."""

from collections.abc import Iterator

import numpy as np

from core.arrays import FloatArray, IntArray
from core.scans.trajectory import Trajectory
from core.topology.lines import SAMPLE_M, Line, driven_lines

TURN_DEG = 50.0
"""How far a drive turns at a corner at least: less is a bend."""
WITHIN_M = 30.0
"""On so many metres: a corner of a city street is driven with a radius of 10 to 15 m."""


def turns(trajectory: Trajectory) -> IntArray:
    """Return the rows of the scans in the middle of turns, rising.

    The direction is that of travel, not of the sensor. Without poses there are none.
    """
    rows = {row for line in driven_lines(trajectory) for row in _turns_of(line)}
    return np.array(sorted(rows), dtype=np.int64)


def _turns_of(line: Line) -> Iterator[int]:
    # The two ends of a line are left out: the direction there is that of a single step.
    half = round(WITHIN_M / 2.0 / SAMPLE_M)
    if len(line.sample_arc_m) <= 2 * half:
        return
    middle = slice(half, len(line.sample_arc_m) - half)
    turned_deg = np.zeros(len(line.sample_arc_m))
    turned_deg[middle] = _between_deg(line.tangent[: -2 * half], line.tangent[2 * half :])
    corner = turned_deg >= TURN_DEG
    edges = np.flatnonzero(np.diff(np.concatenate([[False], corner, [False]]).astype(np.int8)))
    for begin, end in edges.reshape(-1, 2).tolist():
        most = np.flatnonzero(turned_deg[begin:end] >= turned_deg[begin:end].max() - 1.0)
        yield line.row_at(float(line.sample_arc_m[begin + most[len(most) // 2]]))


def _between_deg(before: FloatArray, after: FloatArray) -> FloatArray:
    along = np.clip((before * after).sum(axis=1), -1.0, 1.0)
    return np.asarray(np.degrees(np.arccos(along)))
