"""Notes on drives whose scans are too far apart to find what is between them."""

from collections.abc import Iterator

import numpy as np

from core.scans.path import usual_step_m
from core.scans.pose_steps import jumps
from core.scans.trajectory import Trajectory

_WIDE_M = 6.0  # at 7 m a third are refused: docs/reference/position-measurements.md
_LEAST_WIDE = 3  # steps; fewer are gaps in the recording


def spacing_notes(trajectory: Trajectory) -> Iterator[str]:
    """Yield a note on each drive most of whose way has scans more than 6 m apart.

    Args:
        trajectory: The map's.
    """
    for name in trajectory.drives:
        rows = trajectory.rows_of(name)
        index = trajectory.scan_index[rows]
        found = jumps(index, trajectory.timestamp_s[rows], trajectory.poses[rows])
        steps_m = trajectory.steps_m[rows.start : rows.stop - 1]
        steps_m = steps_m[~np.isin(index[1:], found)]
        usual_m = usual_step_m(steps_m)
        if usual_m > _WIDE_M and int((steps_m > _WIDE_M).sum()) >= _LEAST_WIDE:
            yield (
                f"scans of drive {name} are {usual_m:.1f} m apart: many queries between them are"
                " refused; map scans, also accumulated ones, that are 2 to 4 m apart"
            )
