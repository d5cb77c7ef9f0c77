"""What is above the ground in a scan, to find that of another scan near it."""

from typing import TYPE_CHECKING

import numpy as np

from core.arrays import FloatArray
from core.scans.rigid import planar

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

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
        return share_near(self._tree, points_m, motion, NEAR_M)

    def confirms(self, points_m: FloatArray, motion: FloatArray) -> bool:
        """Return whether a motion fits well, and better than others around it."""
        fit = self.fit(points_m, motion)
        return fit >= LEAST_FIT and all(
            fit >= self.fit(points_m, motion @ other) + BETTER_FIT for other in _AROUND
        )


def share_near(tree: "cKDTree", points_m: FloatArray, motion: FloatArray, within_m: float) -> float:
    """Return the share of returns that are within so many metres of one of a tree, when moved.

    Args:
        tree: The returns of other scans.
        points_m: `(n, 3)` returns, at least one.
        motion: `(4, 4)`, the pose of their scan in the frame of the tree.
        within_m: The largest distance.
    """
    moved_m = points_m @ motion[:3, :3].T + motion[:3, 3]
    apart_m, _ = tree.query(moved_m, distance_upper_bound=within_m)
    return float(np.isfinite(apart_m).mean())
