"""The state of a track as it is stored: small, and good for another start only."""

import math
from dataclasses import dataclass

import numpy as np

from core.arrays import FloatArray
from core.encodings.search import nearest
from core.errors import InvalidParameters
from core.numbers import require_at_least, require_finite
from core.tracking.belief import Belief
from core.tracking.graph import TravelGraph
from core.tracking.motion import Motion

_PLACES = 64  # the most likely ones; the rest of the belief is as good as anywhere
_TRUSTED = 0.5  # share of the stored belief in a resumed one; the rest is that of a new track
# At most in a gap: a metre each at 20 m/s, or a 10 Hz map at twice its pace; of strides of half a
# metre 10 m/s.
_STRIDES_PER_S = 20.0
_MOST_STRIDES = 500  # in a gap; after a longer one the vehicle may be anywhere


@dataclass(frozen=True)
class TrackState:
    """What another process needs to go on with a track.

    Attributes:
        observations: How many the track has had.
        places: The most likely places of `TravelGraph`, and the probability of each.
        elsewhere: Probability of being outside of the map.
        timestamp_s: The time of the last observation that had one.
        sequence: The number of the last observation that had one.
        periods_s: The last times between two observations.

    Raises:
        InvalidParameters: If a number is out of its range.
    """

    observations: int
    places: tuple[tuple[int, float], ...]
    elsewhere: float
    timestamp_s: float | None = None
    sequence: int | None = None
    periods_s: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        require_at_least(0, observations=self.observations, elsewhere=self.elsewhere)
        require_finite(timestamp_s=self.timestamp_s, sequence=self.sequence)
        for name, numbers in (
            ("place", (place for place, _ in self.places)),
            ("probability", (probability for _, probability in self.places)),
            ("period_s", self.periods_s),
        ):
            flaw = next((number for number in numbers if not 0 <= number < math.inf), None)
            require_at_least(0, **{name: flaw})

    def belief(self, graph: TravelGraph, motion: Motion, gap_s: float) -> Belief:
        """Return what is believed after a gap in which nothing was observed.

        The vehicle may have advanced by any number of strides up to a fast one's, at any pace;
        after half a minute it may be anywhere. Half of the belief is that of a new track: so three
        observations place a vehicle that is elsewhere meanwhile.

        Args:
            graph: The map's graph.
            motion: Its paces.
            gap_s: Seconds since the last observation, infinite if not known.

        Raises:
            InvalidParameters: If a place is not of this map.
        """
        at = np.zeros(graph.places)
        for place, probability in self.places:
            if place >= graph.places:
                raise InvalidParameters(f"the map has {graph.places} places, the state {place}")
            at[place] = probability
        rest = max(0.0, 1.0 - self.elsewhere - float(at.sum())) / graph.places
        across = float((1.0 / graph.strides.scans[::2]).sum())  # all of the map
        strides = math.ceil(min(max(gap_s, 0.0) * _STRIDES_PER_S, across))
        if strides > _MOST_STRIDES:
            at = np.full(graph.places, float(at.mean()))
        else:
            at = _spread(at, graph, strides)
        at += rest
        total = float(at.sum()) + self.elsewhere
        new = Belief.unknown(graph, motion)
        return Belief.at_any_pace(
            _TRUSTED / total * at + (1.0 - _TRUSTED) * new.of_place,
            _TRUSTED * self.elsewhere / total + (1.0 - _TRUSTED) * new.elsewhere,
            motion,
        )


def likeliest(belief: Belief) -> tuple[tuple[int, float], ...]:
    """Return the most likely places of a belief, and the probability of each."""
    # NumPy's partition takes ten times as long where most probabilities are equal.
    kept = nearest(-belief.of_place, _PLACES)
    shares = belief.of_place[kept]
    possible = shares > 0.0
    return tuple(zip(kept[possible].tolist(), shares[possible].tolist(), strict=True))


def _spread(at: FloatArray, graph: TravelGraph, strides: int) -> FloatArray:
    """Return the mean of what is believed after 0 to so many strides."""
    from scipy.sparse.csgraph import dijkstra  # only tracks need it: decision 33

    likely = np.flatnonzero(at)
    if not strides or not len(likely):
        return at
    # Of a large map only the places that can be reached are multiplied, once for each stride.
    steps = graph.strides.ahead
    away = dijkstra(steps.T, indices=likely, unweighted=True, limit=strides - 1, min_only=True)
    reached = np.flatnonzero(np.isfinite(away))
    ahead = steps[reached][:, reached]
    moved = at[reached]
    before_last = np.zeros_like(at)
    for _ in range(strides):
        before_last[reached] += moved
        moved = np.asarray(ahead @ moved)
    return np.asarray((at + graph.strides.last @ before_last) / (strides + 1))
