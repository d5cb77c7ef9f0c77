"""The driven lines of a trajectory, sampled evenly."""

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from core.arrays import FloatArray, IntArray
from core.scans.trajectory import Trajectory

SAMPLE_M = 2.0
"""Between samples; a tenth of what parts two meeting places."""
_STEP_M = 1.0  # more than the jitter of a stationary vehicle's poses
_GAP_M = 10.0  # between scans: the path in between is not known


@dataclass(frozen=True, eq=False)
class Line:
    """A path of known poses of one drive, without scans of a stationary vehicle.

    Attributes:
        row: `(n,)` rows of the map's scans along it, rising, from its first to its last; n is at
            least 2.
        arc_m: `(n,)` their arc lengths along the line, from 0.
        sample_arc_m: `(m,)` those of samples, `SAMPLE_M` apart or a little less.
        sample_m: `(m, 3)` the samples.
        tangent: `(m, 2)` direction of travel there, of length 1, or 0 where the line turns back.
    """

    row: IntArray
    arc_m: FloatArray
    sample_arc_m: FloatArray
    sample_m: FloatArray
    tangent: FloatArray

    @property
    def length_m(self) -> float:
        """Arc length from its first scan to its last."""
        return float(self.arc_m[-1])

    def row_at(self, arc_m: float) -> int:
        """Return the row of the scan nearest to an arc length."""
        return int(np.floor(np.interp(arc_m, self.arc_m, self._row_numbers) + 0.5))

    def arc_at(self, row: int | IntArray) -> FloatArray:
        """Return the arc lengths of scans, interpolated between rows of the line."""
        return np.asarray(np.interp(row, self._row_numbers, self.arc_m))

    @cached_property
    def _row_numbers(self) -> FloatArray:
        """The rows as NumPy interpolates them: of a long line converting takes most of the time."""
        return self.row.astype(np.float64)

    @classmethod
    def through(cls, row: IntArray, positions_m: FloatArray) -> "Line":
        """Return the line through `(n, 3)` positions of some rows."""
        arc_m = np.cumsum([0.0, *np.linalg.norm(np.diff(positions_m, axis=0), axis=1)])
        samples = int(np.ceil(arc_m[-1] / SAMPLE_M)) + 1
        sample_arc_m = np.linspace(0.0, arc_m[-1], samples)
        sample_m = np.stack([np.interp(sample_arc_m, arc_m, axis) for axis in positions_m.T], 1)
        chord = np.gradient(sample_m[:, :2], axis=0)
        length = np.linalg.norm(chord, axis=1, keepdims=True)
        steady = length > 0.25 * SAMPLE_M
        tangent = np.divide(chord, length, out=np.zeros_like(chord), where=steady)
        return cls(row, arc_m, sample_arc_m, sample_m, tangent)


def driven_lines(trajectory: Trajectory) -> tuple[Line, ...]:
    """Return the lines of all drives, in order; one breaks where poses are unknown or far apart."""
    positions_m, known = trajectory.poses[:, :3], trajectory.known
    lines: list[Line] = []
    for start, end in itertools.pairwise(trajectory.drive_start.tolist()):
        rows: list[int] = []
        last_m: list[float] = []
        last = start
        for row in range(start, end):
            here_m = positions_m[row].tolist()
            if known[row] and rows:
                step_m = math.dist(here_m, last_m)
                if step_m < _STEP_M:
                    last = row
                    continue
                if step_m <= _GAP_M:
                    rows.append(row)
                    last, last_m = row, here_m
                    continue
            _close(lines, rows, last, positions_m)
            rows, last, last_m = ([row] if known[row] else []), row, here_m
        _close(lines, rows, last, positions_m)
    return tuple(lines)


def _close(lines: list[Line], rows: list[int], last: int, positions_m: FloatArray) -> None:
    """Append a line, which ends at the last scan, also if that is nearer than a step."""
    if len(rows) > 1:
        rows = rows if last == rows[-1] else [*rows, last]
        lines.append(Line.through(np.array(rows, dtype=np.int64), positions_m[rows]))
