"""The motion model: a vehicle stays, advances, turns round, or is moved elsewhere.

Vehicle and map differ in speed and scan rate, so a vehicle has a pace, in strides of the map per
observation, which is mostly constant.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from core.arrays import FloatArray, IntArray, freeze, frozen
from core.errors import InvalidParameters
from core.numbers import require_above
from core.tracking.graph import TravelGraph
from core.tracking.walks import LEAST_WEIGHT, MAX_STRIDES

_FARTHEST_SIGMA = 7.0  # of odometry: 1e-12 of it is farther
_LEAST_M = 1e-6


def _default_paces() -> FloatArray:
    return np.concatenate([[0.0, 0.25, 0.5], 2.0 ** np.arange(0.0, 4.01, 0.5)])


@dataclass(frozen=True, eq=False)
class Motion:
    """Probabilities of motions between two observations.

    Attributes:
        pace: `(P,)` strides of the map between two observations, rising from 0.
        spread: The spread of the strides around the pace, as a share of it.
        keeps: Probability that the pace is unchanged.
        drifts: The probability that the pace changes to a neighbouring one.
        stops: The probability that the vehicle stops at once; the rest is divided equally among all
            paces.
        turns_round: The probability that the direction of travel is reversed.
        jumps: The probability that the vehicle is anywhere in the map: it was moved, or the filter
            was wrong.
        leaves: The probability that it leaves the map. So small that one place of a known street
            that has changed does not seem to be outside of it.
        enters: The probability that it returns to the map.
        metres_spread: The spread of odometry, as a share of it.
        metres_floor: The spread of odometry at a standstill, in metres.
    """

    pace: FloatArray = field(default_factory=_default_paces)
    spread: float = 0.1
    keeps: float = 0.92
    drifts: float = 0.04
    stops: float = 0.02
    turns_round: float = 0.002
    jumps: float = 1e-4
    leaves: float = 1e-4
    enters: float = 1e-3
    metres_spread: float = 0.1
    metres_floor: float = 0.5

    def __post_init__(self) -> None:
        freeze(self, pace=np.float64)
        if self.pace.ndim != 1 or self.pace[0] != 0.0 or not (np.diff(self.pace) > 0).all():
            raise InvalidParameters(f"pace is {self.pace.tolist()}, wanted to rise from 0")
        for name in ("keeps", "drifts", "stops", "turns_round", "jumps", "leaves", "enters"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise InvalidParameters(f"{name} is {getattr(self, name)}, wanted 0..1")
        if self.keeps + self.drifts + self.stops >= 1.0:
            raise InvalidParameters("keeps, drifts and stops sum to 1 or more, wanted less")
        require_above(0, spread=self.spread, metres_spread=self.metres_spread)
        require_above(0, metres_floor=self.metres_floor)

    def prepare(self) -> None:
        """Import what a prediction by odometry needs: no observation waits for it."""
        self.passed_m(np.zeros((MAX_STRIDES + 1, 1)), 0.0)

    @cached_property
    def pace_change(self) -> FloatArray:
        """The probabilities of one pace after another, `(P, P)`, rows sum to 1."""
        paces = len(self.pace)
        rest = 1.0 - self.keeps - self.drifts - self.stops
        change = np.full((paces, paces), rest / paces) + self.keeps * np.eye(paces)
        change[:, 0] += self.stops
        for step in (-1, 1):
            neighbour = np.clip(np.arange(paces) + step, 0, paces - 1)
            np.add.at(change, (np.arange(paces), neighbour), self.drifts / 2.0)
        return frozen(change, np.float64)

    def passed(self, share: float = 1.0) -> FloatArray:
        """Return the probability of each number of strides by pace, `(P, MAX_STRIDES + 1)`.

        Args:
            share: Time since the last observation, as a share of the usual.
        """
        return self._passed_usually if share == 1.0 else self._passed(share)

    @cached_property
    def _passed_usually(self) -> FloatArray:
        """`passed` in the usual time: without times each observation needs it."""
        return frozen(self._passed(1.0), np.float64)

    def _passed(self, share: float) -> FloatArray:
        mean = np.minimum(self.pace * share, MAX_STRIDES)[:, None]
        strides = np.arange(MAX_STRIDES + 1)
        # The number of strides is whole: its spread is at least that of the rounding.
        sigma = np.maximum(self.spread * mean, 0.4)
        weights = np.exp(-0.5 * ((strides - mean) / sigma) ** 2)
        weights[0] = 0.0
        weights[0, 0] = 1.0
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))

    def metres_sigma(self, travelled_m: float) -> float:
        """Return the standard deviation of odometry, in metres."""
        return self.metres_floor + self.metres_spread * abs(travelled_m)

    def passed_m(self, length_m: FloatArray, travelled_m: float, parts: int = 1) -> FloatArray:
        """Return the probability of each number of strides from places, `(MAX_STRIDES + 1, n)`.

        By odometry. A scan means the path half-way to its neighbours, and the vehicle is anywhere
        on it: with a way of a share of a stride it reaches the next scan with that probability. So
        the mean length is the way, also where it is less than half a stride.

        Args:
            length_m: `(MAX_STRIDES + 1, n)`, some columns of `Walks.length_m`.
            travelled_m: Odometry since the last observation.
            parts: Equal parts into which this way is divided, of which one is driven; all of them
                have the spread of the whole way.
        """
        from scipy.special import ndtr  # only tracks need it: decision 33

        way_m = abs(travelled_m) / parts
        sigma_m = self.metres_sigma(travelled_m) / math.sqrt(parts)
        within = length_m <= way_m + _FARTHEST_SIGMA * sigma_m
        near_m = length_m[: np.count_nonzero(within.any(axis=1)) + 1]
        ahead = (way_m - near_m) / sigma_m
        ends_beyond = ndtr(ahead)
        density = np.exp(-0.5 * ahead * ahead) / math.sqrt(2.0 * math.pi)
        beyond_m = sigma_m * (ahead * ends_beyond + density)  # the mean way beyond each scan
        stride_m = np.diff(near_m, axis=0)
        passes = ends_beyond[:-1]  # strides without length, as in a stand
        np.divide(-np.diff(beyond_m, axis=0), stride_m, out=passes, where=stride_m > _LEAST_M)
        # Walks lead ahead only: what the spread has behind the vehicle is taken from what is ahead.
        passes *= way_m / beyond_m[0]
        weights = np.zeros(length_m.shape)
        weights[0] = 1.0
        weights[: len(passes)] -= passes
        weights[1 : len(passes) + 1] += passes
        weights = np.maximum(weights, 0.0) + 1e-12  # where odometry is wrong any is possible
        return np.asarray(weights / weights.sum(axis=0))

    def advance(
        self,
        places: IntArray,
        at: FloatArray,
        graph: TravelGraph,
        share: float = 1.0,
        travelled_m: float | None = None,
        parts: int = 1,
    ) -> tuple[IntArray, FloatArray]:
        """Return the probabilities after the motion to the next observation, without jumps.

        A motion in several parts is advanced by one of them at a time.

        Args:
            places: `(n,)` all places of the map, or few of them in both directions; rising.
            at: `(n, P)` the probability of each, and of each pace.
            graph: The map's graph.
            share: Time since the last observation, as a share of the usual.
            travelled_m: Odometry since the last observation, negative backwards. It replaces the
                pace at places from which the length of `MAX_STRIDES` strides is known.
            parts: Equal parts into which time and odometry are divided.

        Returns:
            `(m,)` the places that may be reached, rising, and `(m, P)` the probability of each.
        """
        both = at.reshape(-1, 2, len(self.pace))
        both = (1.0 - self.turns_round) * both + self.turns_round * both[:, ::-1]
        metres = travelled_m if graph.has_lengths else None
        backwards = metres is not None and metres < 0.0
        if backwards:
            both = both[:, ::-1]
        begin = both.reshape(-1, len(self.pace)) @ self.pace_change
        if metres is None:
            return _moved(places, begin, graph, self._by_pace(share / parts))
        length_m = graph.walks.length_m[:, places]
        known = ~np.isnan(length_m[-1])  # the longest walk is unknown where any shorter one is
        all_known = bool(known.all())
        by_metres = self.passed_m(length_m, metres, parts)
        if not all_known:
            by_metres = np.where(known, by_metres, 0.0)
        reached, moved = _moved(places, begin, graph, by_metres[:, :, None])
        if backwards:
            moved = _reversed(moved)
        if not all_known:
            # By pace, and forwards: the sign alone may be the noise of a vehicle at a standstill.
            others = begin * ~known[:, None]
            others = _reversed(others) if backwards else others
            moved = moved + _moved(places, others, graph, self._by_pace(share / parts))[1]
        return reached, moved

    def _by_pace(self, share: float) -> FloatArray:
        """Return `passed` as it is of any place, `(MAX_STRIDES + 1, 1, P)`."""
        return self.passed(share).T[:, None]


def _moved(
    places: IntArray, begin: FloatArray, graph: TravelGraph, weights: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return the places that are reached, rising, and `(m, P)`: few places, or all of the map."""
    if len(places) < graph.places:
        return graph.walks.moved(places, begin, weights)
    return places, _advance(begin, graph, weights)


def _reversed(at: FloatArray) -> FloatArray:
    """Return the probabilities of places in the other direction, `(n, P)`."""
    return at.reshape(-1, 2, at.shape[1])[:, ::-1].reshape(at.shape)


def _advance(at: FloatArray, graph: TravelGraph, weights: FloatArray) -> FloatArray:
    """Return the places after each number of strides, weighted, `(2K, P)`, by Horner's rule.

    It is w_0 * at + B sum_n A^(n - 1) (w_n * at), with the last stride B and others A.
    """
    used = np.flatnonzero(weights.reshape(len(weights), -1).max(axis=1) > LEAST_WEIGHT)
    moved = np.zeros_like(at)
    for count in range(int(used.max(initial=0)), 0, -1):
        moved = np.asarray(graph.strides.ahead @ moved)
        moved += weights[count] * at
    moved = np.asarray(graph.strides.last @ moved)
    moved += weights[0] * at
    return moved
