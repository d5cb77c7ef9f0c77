"""How often a drive comes back to where it was: a check of a reader by its poses."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from core.scans.angles import wrapped_deg
from core.scans.drive import Drive
from core.scans.pose import heading_deg, is_known


@dataclass(frozen=True)
class Revisits:
    """Every third scan that comes back within 3 m after more than 30 s: a check of the poses.

    Attributes:
        found: How many do.
        reversed: How many of them head more than 90 degrees away from the nearest such place.
    """

    found: int
    reversed: int

    def agrees_with(self, known: "Revisits") -> bool:
        """Return whether both counts are as known, but for 2 scans and 2 %.

        Published poses of one sequence differ by some decimetres.
        """
        pairs = ((self.found, known.found), (self.reversed, known.reversed))
        return all(abs(own - other) <= 2 + 0.02 * other for own, other in pairs)

    def __str__(self) -> str:
        return f"{self.found} ({self.reversed} in reverse)"


KNOWN_REVISITS: Mapping[str, Revisits] = {
    "00": Revisits(259, 2),
    "02": Revisits(98, 14),
    "05": Revisits(142, 0),
    "06": Revisits(89, 0),
    "07": Revisits(10, 0),
    "08": Revisits(107, 100),
}
"""The known revisits of KITTI's sequences."""
_REVISIT_EVERY, _REVISIT_WITHIN_M, _REVISIT_AFTER_S = 3, 3.0, 30.0


def revisits(drive: Drive) -> Revisits:
    """Count a drive's revisits; scans without a pose or a time are left out."""
    rows = drive.poses[::_REVISIT_EVERY]
    time_s = drive.timestamp_s[::_REVISIT_EVERY]
    known = is_known(rows) & np.isfinite(time_s)
    rows, time_s = rows[known], time_s[known]
    heading = heading_deg(rows)
    found = reversed_ = 0
    for scan in range(len(rows)):
        before = np.flatnonzero(time_s < time_s[scan] - _REVISIT_AFTER_S)
        if not len(before):
            continue
        apart_m = np.linalg.norm(rows[before, :3] - rows[scan, :3], axis=1)
        nearest = before[apart_m.argmin()]
        if apart_m.min() <= _REVISIT_WITHIN_M:
            found += 1
            reversed_ += bool(abs(wrapped_deg(heading[nearest] - heading[scan])) > 90.0)
    return Revisits(found, reversed_)
