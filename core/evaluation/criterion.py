"""Which answers are right, independent of the map's ranks and cuts."""

from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray, freeze
from core.evaluation.metrics import apart_m
from core.evaluation.motion import is_standing
from core.numbers import require_above, require_at_least
from core.scans.pose import is_known


@dataclass(frozen=True, eq=False)
class Criterion:
    """Compares a query with the scan of the same drive that answered it.

    With poses an answer is right if both were recorded within `tolerance_m`; where a pose is
    unknown, if their indices differ by at most `tolerance_scans`. This does not depend on the
    segments, so answers of maps that are cut differently can be compared.

    Attributes:
        poses: `(K, 7)` of the drive, NaN where unknown.
        timestamp_s: `(K,)`, NaN where unknown.
        tolerance_m: Metres.
        tolerance_scans: Scans.
    """

    poses: FloatArray
    timestamp_s: FloatArray
    tolerance_m: float = 3.0
    tolerance_scans: int = 3

    def __post_init__(self) -> None:
        freeze(self, poses=np.float64, timestamp_s=np.float64)
        require_above(0, tolerance_m=self.tolerance_m)
        require_at_least(0, tolerance_scans=self.tolerance_scans)

    def __str__(self) -> str:
        near = f"within {self.tolerance_scans} scans of the query"
        known = is_known(self.poses)
        if known.all():
            return f"the matched scan was recorded within {self.tolerance_m:g} m"
        if known.any():
            return f"the matched scan was recorded within {self.tolerance_m:g} m, or is {near}"
        return f"the matched scan is {near}"

    @property
    def standing(self) -> BoolArray:
        """Which scans were recorded while stationary, `(K,)`; none where poses are unknown."""
        return is_standing(self.poses, self.timestamp_s)

    def distance_m(self, queried: IntArray, answered: IntArray) -> FloatArray:
        """Return how far apart two scans were recorded, NaN where that is not known."""
        return apart_m(self.poses[queried], self.poses[answered])

    def right(self, queried: IntArray, answered: IntArray) -> BoolArray:
        """Return which answers are right; indices broadcast against each other.

        Examples:
            >>> poses = np.zeros((3, 7))
            >>> poses[:, 0], poses[:, 6] = [0.0, 2.0, 9.0], 1.0
            >>> criterion = Criterion(poses, np.arange(3.0))
            >>> criterion.right(np.array([0, 0]), np.array([1, 2])).tolist()
            [True, False]
        """
        distance_m = self.distance_m(queried, answered)
        near = np.abs(queried - answered) <= self.tolerance_scans
        return np.where(np.isnan(distance_m), near, distance_m <= self.tolerance_m)

    def other_pass(self, queried: IntArray, answered: IntArray) -> BoolArray:
        """Return which answers, `(n,)`, are right and of another pass through the query's place.

        Between the two scans the vehicle was farther away than `tolerance_m`.
        """
        found = self.right(queried, answered)
        for row in np.flatnonzero(found).tolist():
            first, last = sorted((int(queried[row]), int(answered[row])))
            away_m = self.distance_m(queried[row], np.arange(first, last + 1))
            found[row] = bool((away_m > self.tolerance_m).any())
        return found


def counted(standing: BoolArray) -> BoolArray:
    """Return which queries count: stationary ones do not, if any was recorded while moving."""
    return np.asarray(~standing if not standing.all() else standing)
