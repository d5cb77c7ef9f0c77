"""Whether the returns of a drive are in the frame of its poses, and not in the sensor's.

SLAM exports clouds that are registered already. The middle of such a cloud moves as the pose does;
in the sensor's frame it stays about where it is, whatever the sensor sees.
"""

import numpy as np

from core.arrays import FloatArray
from core.errors import InvalidScan
from core.scans.drive import Drive
from core.scans.pose import is_known
from core.scans.sampling import spread_evenly

_SCANS = 8
_FEWEST = 4  # what a few see may differ as their poses do by chance
_LEAST_M = 5.0  # least motion of the sensor, root mean square: less may be a change of what it sees
# Of that, what is left when the poses are subtracted from the middles. Recorded drives in the
# sensor's frame have 0.9 and more, also of 30 scans or 70 degrees; registered ones mostly 0.2.
_LEFT = 0.4


def is_in_map_frame(drive: Drive) -> bool:
    """Return whether the scans of a drive with poses move along with these.

    Args:
        drive: The drive as its sensor recorded it.
    """
    positions_m, middles_m = [], []
    for row in spread_evenly(np.flatnonzero(is_known(drive.poses)), _SCANS).tolist():
        try:
            middles_m.append(np.median(drive.scan(row).points_m[:, :2], axis=0))
        except InvalidScan:  # left out of maps too, with a note
            continue
        positions_m.append(drive.poses[row, :2])
    if len(middles_m) < _FEWEST:
        return False
    positions, middles = np.array(positions_m), np.array(middles_m, np.float64)
    moved_m = _spread_m(positions)
    return moved_m >= _LEAST_M and _spread_m(middles - positions) < _LEFT * moved_m


def _spread_m(points_m: FloatArray) -> float:
    """Return the distance of `(n, 2)` points from their mean, root mean square."""
    return float(np.sqrt(np.sum(np.var(points_m, axis=0))))
