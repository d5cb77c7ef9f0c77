"""Where a drive turns, by its poses: there the graph has nodes (paper, sec. 1)."""

from collections.abc import Iterator

import numpy as np

from core.arrays import FloatArray, IntArray
from core.scans.trajectory import Trajectory
from core.topology.joining import CUT_M
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


def cut_at_turns(trajectory: Trajectory, segment_start: IntArray) -> IntArray:
    """Cut segments in the middle of turns too, `(L' + 1,)` starts and the end.

    A turn within `CUT_M` of a cut has its node there. Without poses nothing is cut.

    Args:
        trajectory: The trajectory of all drives.
        segment_start: `(L + 1,)` rows where segments begin, and K.
    """
    added: list[int] = []
    for line in driven_lines(trajectory):
        first, last = np.searchsorted(segment_start, [line.row[0], line.row[-1] + 1])
        cuts_m = line.arc_at(segment_start[first:last])
        for row in _turns_of(line):
            if not (np.abs(cuts_m - line.arc_at(row)) <= CUT_M).any():
                added.append(row)
                cuts_m = np.append(cuts_m, line.arc_at(row))
    return np.union1d(segment_start, np.array(added, dtype=np.int64))


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
