"""Notes on drives whose scans are too far apart to find what is between them."""

from collections.abc import Iterator

from core.scans.path import usual_step_m
from core.scans.trajectory import Trajectory

_WIDE_M = 6.0  # at 7 m a third are refused: docs/reference/position-measurements.md


def spacing_notes(trajectory: Trajectory) -> Iterator[str]:
    """Yield a note on each drive most of whose way has scans more than 6 m apart.

    Args:
        trajectory: The map's.
    """
    ends = trajectory.drive_start.tolist()
    for name, start, end in zip(trajectory.drives, ends[:-1], ends[1:], strict=True):
        usual_m = usual_step_m(trajectory.steps_m[start : end - 1])
        if usual_m > _WIDE_M:
            yield (
                f"scans of drive {name} are {usual_m:.1f} m apart: many queries between them are"
                " refused; map scans, also accumulated ones, that are 2 to 4 m apart"
            )
