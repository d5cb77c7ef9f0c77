"""The state of the Bayes filter: a distribution over place, direction and pace.

When a track is sure, nearly all of it is in few places. Only there the probability of each pace is
kept, of the other places that of standing still and that of moving: to pass over all paces of a
large map takes as long as to compare a query.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from core.arrays import FloatArray, IntArray, freeze
from core.encodings.search import nearest
from core.errors import InvalidParameters
from core.tracking.graph import TravelGraph
from core.tracking.motion import Motion
from core.tracking.stationary import PaceLikelihood
from core.tracking.walks import places_of

_SUM_TOLERANCE = 1e-7  # what is less likely than 1e-9 is not advanced, in up to 16 parts of a way
_UNLIKELY = 1e-4  # of the belief in the map, in all places together that are not likely
# The likely scans are kept apart if they are so many times fewer than all: at a quarter of the map
# their walks took longer than those of all, and three times the memory; at a tenth they are faster.
_TIMES_FEWER = 10
_MOST_LIKELY = 512  # scans that are advanced of a map that has more than ten times as many


@dataclass(frozen=True, eq=False)
class Belief:
    """A distribution over places and paces, and the probability of being outside the map.

    Attributes:
        places: `(n,)` the likely places, rising; place `2 row` is a scan passed along its segment,
            `2 row + 1` against it.
        at: `(n, P)` the probability of each, and of each pace.
        others: `(2, 2K)` of each other place, at pace 0 and at all other paces, which are alike;
            0 of the likely ones.
        elsewhere: The probability of being outside of the map.

    Raises:
        InvalidParameters: If they are negative or do not sum to 1.
    """

    places: IntArray
    at: FloatArray
    others: FloatArray
    elsewhere: float

    def __post_init__(self) -> None:
        freeze(self, places=np.int64, at=np.float64, others=np.float64)
        object.__setattr__(self, "elsewhere", float(self.elsewhere))
        total = float(self.at.sum() + self.others.sum()) + self.elsewhere
        least = min(self.at.min(initial=0.0), self.others.min(initial=0.0), self.elsewhere)
        if not (abs(total - 1.0) <= _SUM_TOLERANCE and least >= 0.0):
            raise InvalidParameters(f"the probabilities of a belief sum to {total}, wanted 1")
        if (self.places[1:] <= self.places[:-1]).any() or self.others[:, self.places].any():
            raise InvalidParameters("the likely places must rise and be none of the others")

    @classmethod
    def at_any_pace(cls, of_place: FloatArray, elsewhere: float, motion: Motion) -> "Belief":
        """Return a belief in places, `(2K,)`, at each of which all paces are as likely."""
        paces = len(motion.pace)
        others = np.stack([of_place, (paces - 1) * of_place]) / paces
        return cls(np.empty(0, np.int64), np.empty((0, paces)), others, elsewhere)

    @classmethod
    def unknown(cls, graph: TravelGraph, motion: Motion) -> "Belief":
        """Return the belief before any observation: half of it outside of the map."""
        return cls.at_any_pace(np.full(graph.places, 0.5 / graph.places), 0.5, motion)

    @cached_property
    def of_place(self) -> FloatArray:
        """The probability of each place, `(2K,)`."""
        found: FloatArray = self.others[0] + self.others[1]
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
        if len(self.places) == self.others.shape[1]:
            return self.at[places]
        found = _at_each_pace(self.others[:, places], self.at.shape[1])
        if len(self.places):
            position = np.minimum(np.searchsorted(self.places, places), len(self.places) - 1)
            kept = self.places[position] == places
            found[kept] = self.at[position[kept]]
        return found

    def predicted(
        self,
        graph: TravelGraph,
        motion: Motion,
        share: float = 1.0,
        travelled_m: float | None = None,
        parts: int = 1,
    ) -> "Belief":
        """Return the belief before the next observation.

        Of a belief in few places only these are advanced. The others, a ten-thousandth of it in
        all, stay where they are: they are nearly even, and advance when they become likely.

        Args:
            graph: The map's graph.
            motion: How vehicles move.
            share: Time since the last observation, as a share of the usual.
            travelled_m: Odometry since the last observation, negative backwards; used where the
                map knows its metres.
            parts: Equal parts into which both are divided; the belief is that after one of them.
        """
        likely = self._likely()
        places, moved = motion.advance(
            likely, self.by_pace(likely), graph, share, travelled_m, parts
        )
        others = self.others.copy()
        others[0, self.places] = self.at[:, 0]
        others[1, self.places] = self.at[:, 1:] @ np.ones(self.at.shape[1] - 1)
        others[:, likely] = 0.0
        paces = moved.shape[1]
        moved += _at_each_pace(others[:, places], paces)
        within = 1.0 - self.elsewhere  # the motion conserves it
        anywhere = motion.jumps * within + motion.enters * self.elsewhere
        each = anywhere / (graph.places * paces)
        stays = 1.0 - motion.jumps - motion.leaves
        moved *= stays
        moved += each
        others *= stays
        others[0] += each
        others[1] += each * (paces - 1)
        others[:, places] = 0.0
        elsewhere = (1.0 - motion.enters) * self.elsewhere + motion.leaves * within
        return Belief(places, moved, others, elsewhere)

    def updated(self, of_scan: FloatArray, paces: PaceLikelihood) -> "Belief":
        """Return the belief after an observation.

        Args:
            of_scan: `(K,)` its likelihood at each scan, finite and at least 0; elsewhere it is 1.
            paces: The observation's likelihood at each pace.
        """
        of_place = np.repeat(of_scan, 2)
        at = paces.at(self.places)
        at *= self.at
        at *= of_place[self.places, None]
        others = paces.still_or_moving * self.others
        others *= of_place
        total = float(at.sum() + others.sum()) + self.elsewhere
        at /= total
        others /= total
        return Belief(self.places, at, others, self.elsewhere / total)

    def _likely(self) -> IntArray:
        """Return the places, in both directions, that hold nearly all of it if these are few.

        Otherwise all, or of a large map those of the likeliest scans. With its first observations a
        vehicle's place becomes one of them.
        """
        of_scan = self.of_scan
        likely = np.flatnonzero(of_scan > _UNLIKELY * of_scan.mean())
        if _TIMES_FEWER * min(len(likely), _MOST_LIKELY) >= len(of_scan):
            return np.arange(2 * len(of_scan))
        if len(likely) > _MOST_LIKELY:
            likely = np.sort(nearest(-of_scan, _MOST_LIKELY))
        return places_of(likely)


def _at_each_pace(still_or_moving: FloatArray, paces: int) -> FloatArray:
    """Return `(n, P)` probabilities of `(2, n)` ones at pace 0 and at all others, as `others`."""
    found = np.empty((still_or_moving.shape[1], paces))
    found[:, 0] = still_or_moving[0]
    found[:, 1:] = still_or_moving[1, :, None] / max(1, paces - 1)
    return found
