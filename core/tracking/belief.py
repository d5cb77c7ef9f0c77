"""The state of the Bayes filter: a distribution over place, direction and pace.

Of a sure track nearly all of it is in few places. Only of these is each pace kept: a large map's
numbers of all paces take longer to pass over than a query takes to compare.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from core.arrays import FloatArray, IntArray, frozen
from core.errors import InvalidParameters
from core.tracking.graph import TravelGraph
from core.tracking.motion import Motion
from core.tracking.stationary import PaceLikelihood

_SUM_TOLERANCE = 1e-9
_UNLIKELY = 1e-4  # of the belief in the map, in all places together that are not likely
# Times fewer places than the map has are kept apart: at a quarter of them their walks took three
# times the memory of all and longer, at a tenth they are faster.
_FEW = 10


@dataclass(frozen=True, eq=False)
class Belief:
    """A distribution over places and paces, and the probability of being outside the map.

    Attributes:
        places: `(n,)` the likely places, rising; place `2 row` is a scan passed along its segment,
            `2 row + 1` against it.
        at: `(n, P)` the probability of each, and of each pace.
        others: `(2K,)` of each other place, at all paces alike; 0 of the likely ones.
        elsewhere: Of being outside of the map.

    Raises:
        InvalidParameters: If they are negative or do not sum to 1.
    """

    places: IntArray
    at: FloatArray
    others: FloatArray
    elsewhere: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "places", frozen(self.places, np.int64))
        object.__setattr__(self, "at", frozen(self.at, np.float64))
        object.__setattr__(self, "others", frozen(self.others, np.float64))
        object.__setattr__(self, "elsewhere", float(self.elsewhere))
        total = float(self.at.sum() + self.others.sum()) + self.elsewhere
        least = min(self.at.min(initial=0.0), self.others.min(initial=0.0), self.elsewhere)
        if not (abs(total - 1.0) <= _SUM_TOLERANCE and least >= 0.0):
            raise InvalidParameters(f"the probabilities of a belief sum to {total}, wanted 1")

    @classmethod
    def in_all(cls, at: FloatArray, elsewhere: float) -> "Belief":
        """Return a belief of which each pace is kept everywhere, `(2K, P)`."""
        return cls(np.arange(len(at)), at, np.zeros(len(at)), elsewhere)

    @classmethod
    def unknown(cls, graph: TravelGraph, motion: Motion) -> "Belief":
        """Return the belief before any observation: half of it outside of the map."""
        shape = (graph.places, len(motion.pace))
        return cls.in_all(np.full(shape, 0.5 / (shape[0] * shape[1])), 0.5)

    @cached_property
    def of_place(self) -> FloatArray:
        """The probability of each place, `(2K,)`."""
        found = self.others.copy()
        found[self.places] = self.at @ np.ones(self.at.shape[1])
        return found

    @cached_property
    def of_scan(self) -> FloatArray:
        """The probability of each scan of the map, `(K,)`."""
        return self.of_place[::2] + self.of_place[1::2]

    def along(self, rows: IntArray) -> FloatArray:
        """Return the probability of some scans, passed along their segments, `(n,)`."""
        return np.asarray(self.of_place[2 * rows])

    def by_pace(self, places: IntArray) -> FloatArray:
        """Return the probability of some places and of each pace, `(n, P)`."""
        paces = self.at.shape[1]
        found = np.repeat(self.others[places, None] / paces, paces, axis=1)
        if len(self.places):
            position = np.minimum(np.searchsorted(self.places, places), len(self.places) - 1)
            kept = self.places[position] == places
            found[kept] = self.at[position[kept]]
        return found

    def predicted(
        self,
        graph: TravelGraph,
        motion: Motion,
        scale: float = 1.0,
        travelled_m: float | None = None,
    ) -> "Belief":
        """Return the belief before the next observation.

        Of a belief in few places only these are advanced. The others, a ten-thousandth of it in
        all, stay where they are: they are nearly even, and advance when they become likely.

        Args:
            graph: Of the map.
            motion: How vehicles move.
            scale: Time since the last observation, as a share of the usual.
            travelled_m: Odometry since the last observation, negative backwards; used if the map
                has poses.
        """
        likely = self._likely()
        places, moved = motion.advance(likely, self.by_pace(likely), graph, scale, travelled_m)
        others = self.of_place.copy()
        others[likely] = 0.0
        paces = moved.shape[1]
        moved += others[places, None] / paces
        others[places] = 0.0
        within = float(moved.sum() + others.sum())
        anywhere = motion.jumps * within + motion.leaves * self.elsewhere
        each = anywhere / (graph.places * paces)
        for kept, of_each in ((moved, each), (others, paces * each)):
            kept *= 1.0 - motion.jumps - motion.leaves
            kept += of_each
        others[places] = 0.0
        elsewhere = (1.0 - motion.leaves) * self.elsewhere + motion.leaves * within
        return _normalized(places, moved, others, elsewhere)

    def updated(self, of_scan: FloatArray, paces: PaceLikelihood | None = None) -> "Belief":
        """Return the belief after an observation.

        Args:
            of_scan: `(K,)` its likelihood at each scan, finite and at least 0; elsewhere it is 1.
            paces: Its likelihood at each pace.
        """
        of_place = np.repeat(of_scan, 2)
        at, others = self.at * of_place[self.places, None], self.others * of_place
        if paces is not None:
            at *= paces.at(self.places)
            others *= paces.mean()
        return _normalized(self.places, at, others, self.elsewhere)

    def _likely(self) -> IntArray:
        """Return the places, in both directions, that hold nearly all of it if these are few."""
        of_scan = self.of_scan
        likely = np.flatnonzero(of_scan > _UNLIKELY * of_scan.mean())
        if _FEW * len(likely) >= len(of_scan):
            return np.arange(2 * len(of_scan))
        return (2 * likely[:, None] + np.arange(2)).reshape(-1)


def _normalized(places: IntArray, at: FloatArray, others: FloatArray, elsewhere: float) -> Belief:
    total = float(at.sum() + others.sum()) + elsewhere
    at /= total
    others /= total
    return Belief(places, at, others, elsewhere / total)
