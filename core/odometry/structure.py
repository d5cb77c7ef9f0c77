"""What is above the ground in a scan, to find that of another scan near it."""

import numpy as np

from core.arrays import FloatArray
from core.scans.rigid import planar

NEAR_M = 0.5
"""Between a return and one of the other scan."""
LEAST_FIT, BETTER_FIT = 0.35, 0.05
"""Shares of the returns: of a motion that is right, and what other motions lack."""
_LEAST_RETURNS = 50
_ASIDE_M, _ASIDE_DEG = 1.0, 5.0
_AROUND = (
    planar(_ASIDE_M, 0.0, 0.0),
    planar(-_ASIDE_M, 0.0, 0.0),
    planar(0.0, _ASIDE_M, 0.0),
    planar(0.0, -_ASIDE_M, 0.0),
    planar(0.0, 0.0, _ASIDE_DEG),
    planar(0.0, 0.0, -_ASIDE_DEG),
)
"""Other motions: poses that fit better than with each of these are right."""


class Structure:
    """The returns of a scan, to find those of another one near them."""

    def __init__(self, points_m: FloatArray) -> None:
        from scipy.spatial import cKDTree  # no answer needs it: decision 33

        self._tree = cKDTree(points_m)

    @property
    def is_little(self) -> bool:
        """Whether a motion cannot be seen in it."""
        return self._tree.n < _LEAST_RETURNS

    def fit(self, points_m: FloatArray, motion: FloatArray) -> float:
        """Return the share of another scan's returns that are near one, after that motion."""
        if len(points_m) < _LEAST_RETURNS:
            return 0.0
        moved_m = points_m @ motion[:3, :3].T + motion[:3, 3]
        apart_m, _ = self._tree.query(moved_m, distance_upper_bound=NEAR_M)
        return float(np.isfinite(apart_m).mean())

    def confirms(self, points_m: FloatArray, motion: FloatArray) -> bool:
        """Return whether a motion fits well, and better than others around it."""
        fit = self.fit(points_m, motion)
        return fit >= LEAST_FIT and all(
            fit >= self.fit(points_m, motion @ other) + BETTER_FIT for other in _AROUND
        )
