"""The state of the Bayes filter: a distribution over place, direction and pace."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from core.arrays import FloatArray, IntArray, frozen
from core.errors import InvalidParameters
from core.tracking.graph import TravelGraph, of_scans
from core.tracking.motion import Motion

_SUM_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Belief:
    """A distribution over places and paces, and the probability of being outside the map.

    Attributes:
        at: `(2K, P)`, of each place and pace; place `2 row` is a scan passed along its segment,
            `2 row + 1` against it.
        elsewhere: Of being outside of the map.

    Raises:
        InvalidParameters: If they are negative or do not sum to 1.
    """

    at: FloatArray
    elsewhere: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", frozen(self.at, np.float64))
        object.__setattr__(self, "elsewhere", float(self.elsewhere))
        total = float(self.at.sum()) + self.elsewhere
        if not (abs(total - 1.0) <= _SUM_TOLERANCE and self.at.min() >= 0 <= self.elsewhere):
            raise InvalidParameters(f"the probabilities of a belief sum to {total}, wanted 1")

    @cached_property
    def of_scan(self) -> FloatArray:
        """The probability of each scan of the map, `(K,)`."""
        return of_scans(self.at)

    @property
    def of_place(self) -> FloatArray:
        """The probability of each place, `(2K,)`."""
        return self.at @ np.ones(self.at.shape[1])

    def along(self, rows: IntArray) -> FloatArray:
        """Return the probability of some scans, passed along their segments, `(n,)`."""
        return np.asarray(self.at[2 * rows].sum(axis=1))

    @classmethod
    def unknown(cls, graph: TravelGraph, motion: Motion) -> "Belief":
        """Return the belief before any observation: half of it outside of the map."""
        shape = (graph.places, len(motion.pace))
        return cls(np.full(shape, 0.5 / (shape[0] * shape[1])), 0.5)

    def predicted(
        self,
        graph: TravelGraph,
        motion: Motion,
        scale: float = 1.0,
        travelled_m: float | None = None,
    ) -> "Belief":
        """Return the belief before the next observation; see `Motion.advance`."""
        moved = motion.advance(self.at, graph, scale, travelled_m)
        within = float(moved.sum())
        anywhere = motion.jumps * within + motion.leaves * self.elsewhere
        moved *= 1.0 - motion.jumps - motion.leaves
        moved += anywhere / moved.size
        elsewhere = (1.0 - motion.leaves) * self.elsewhere + motion.leaves * within
        return _normalized(moved, elsewhere)

    def updated(self, likelihood: FloatArray) -> "Belief":
        """Return the belief after an observation.

        Args:
            likelihood: `(2K, P)` or broadcast to it, finite and at least 0; elsewhere it is 1.
        """
        return _normalized(self.at * likelihood, self.elsewhere)


def _normalized(at: FloatArray, elsewhere: float) -> Belief:
    total = float(at.sum()) + elsewhere
    at /= total
    return Belief(at, elsewhere / total)
