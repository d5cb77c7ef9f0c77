"""How a vehicle moves between two observations: it stays, advances, turns round, or is carried off.

Maps and vehicles drive at their own speeds and scan as often as they like, so a vehicle has a pace,
in scans of the map from one observation to the next, which it mostly keeps.
"""

from dataclasses import dataclass, field

import numpy as np

from core.arrays import FloatArray, frozen
from core.errors import InvalidParameters
from core.tracking.graph import TravelGraph

MAX_STEPS = 24
"""Scans of the map that are passed at most between two observations."""


def _default_paces() -> FloatArray:
    return np.concatenate([[0.0, 0.25, 0.5], 2.0 ** np.arange(0.0, 4.01, 0.5)])


@dataclass(frozen=True, eq=False)
class Motion:
    """How likely which move is.

    Attributes:
        pace: `(P,)` scans of the map between two observations, rising from 0.
        spread: Of the scans passed around the pace, as a share of it.
        keeps: Probability that the pace stays as it is.
        drifts: That it becomes a neighbouring one.
        stops: That the vehicle stops at once; the rest is divided among all paces.
        turns_round: That the direction of travel is reversed.
        jumps: That the vehicle is anywhere in the map: carried there, or the filter was wrong.
        leaves: That it leaves the map, or comes back from outside.
        metres_spread: Of odometry, as a share of it.
        metres_floor: The same at a standstill, in metres.
    """

    pace: FloatArray = field(default_factory=_default_paces)
    spread: float = 0.1
    keeps: float = 0.92
    drifts: float = 0.04
    stops: float = 0.02
    turns_round: float = 0.002
    jumps: float = 1e-4
    leaves: float = 1e-3
    metres_spread: float = 0.1
    metres_floor: float = 0.5

    def __post_init__(self) -> None:
        object.__setattr__(self, "pace", frozen(self.pace, np.float64))
        if self.pace.ndim != 1 or self.pace[0] != 0.0 or not (np.diff(self.pace) > 0).all():
            raise InvalidParameters(f"pace is {self.pace.tolist()}, wanted to rise from 0")
        for name in ("keeps", "drifts", "stops", "turns_round", "jumps", "leaves"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise InvalidParameters(f"{name} is {getattr(self, name)}, wanted 0..1")
        if self.keeps + self.drifts + self.stops >= 1.0:
            raise InvalidParameters("keeps, drifts and stops leave nothing for other paces")
        if min(self.spread, self.metres_spread, self.metres_floor) <= 0.0:
            raise InvalidParameters("spreads are above 0")

    def pace_change(self) -> FloatArray:
        """Return how a pace becomes another, `(P, P)`, rows sum to 1."""
        paces = len(self.pace)
        rest = 1.0 - self.keeps - self.drifts - self.stops
        change = np.full((paces, paces), rest / paces) + self.keeps * np.eye(paces)
        change[:, 0] += self.stops
        for step in (-1, 1):
            neighbour = np.clip(np.arange(paces) + step, 0, paces - 1)
            np.add.at(change, (np.arange(paces), neighbour), self.drifts / 2.0)
        return change

    def passed(self, scale: float = 1.0) -> FloatArray:
        """Return how likely how many scans are passed at each pace, `(P, MAX_STEPS + 1)`.

        Args:
            scale: How long it is since the last observation, as a share of the usual time.
        """
        wanted = np.minimum(self.pace * scale, MAX_STEPS)[:, None]
        steps = np.arange(MAX_STEPS + 1)
        # Whole scans round a pace: at least the spread of the rounding.
        sigma = np.maximum(self.spread * wanted, 0.4)
        weights = np.exp(-0.5 * ((steps - wanted) / sigma) ** 2)
        weights[0] = 0.0
        weights[0, 0] = 1.0
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))

    def passed_m(self, graph: TravelGraph, travelled_m: float) -> FloatArray:
        """Return how likely how many scans are passed from each place, `(MAX_STEPS + 1, 2K)`.

        Odometry tells the metres, the map how many scans they are: a scan counts by how near it is
        to that distance and by how much of the way it stands for.
        """
        sigma = self.metres_floor + self.metres_spread * abs(travelled_m)
        distance_m = np.zeros(graph.places)
        weights = np.empty((MAX_STEPS + 1, graph.places))
        known = np.where(np.isnan(graph.step_m), 1.0, graph.step_m)
        back = graph.ahead.T.tocsr()
        remaining = np.zeros(graph.places)
        for step in range(MAX_STEPS + 1):
            weights[step] = np.exp(-0.5 * ((distance_m - abs(travelled_m)) / sigma) ** 2)
            remaining = known + back @ remaining
            distance_m = remaining
        # Nothing within reach: as far as the map goes.
        weights += 1e-12
        return np.asarray(weights / weights.sum(axis=0))


def predict(
    belief: FloatArray,
    graph: TravelGraph,
    motion: Motion,
    scale: float = 1.0,
    travelled_m: float | None = None,
) -> FloatArray:
    """Move a belief on by one observation, without what is jumped or left.

    Args:
        belief: `(2K, P)`, what is believed of each place and pace.
        graph: Where a vehicle can go.
        motion: How it moves.
        scale: Time since the last observation, as a share of the usual.
        travelled_m: Odometry since the last observation, negative backwards; used where the map
            knows metres.
    """
    turned = motion.turns_round
    belief = (1.0 - turned) * belief + turned * belief[graph.reverse]
    belief = belief @ motion.pace_change()
    if travelled_m is not None and not np.isnan(graph.step_m).any():
        weights = motion.passed_m(graph, travelled_m)
        if travelled_m < 0:
            backed = _advance(belief[graph.reverse], graph, weights[:, :, None])
            return np.asarray(backed[graph.reverse])
        return _advance(belief, graph, weights[:, :, None])
    return _advance(belief, graph, motion.passed(scale).T[:, None, :])


def _advance(belief: FloatArray, graph: TravelGraph, weights: FloatArray) -> FloatArray:
    """Return sum_n A^n (w_n * belief) by Horner's rule, `(2K, P)`."""
    used = np.flatnonzero(weights.reshape(len(weights), -1).max(axis=1) > 1e-9)
    moved = np.zeros_like(belief)
    for step in range(int(used[-1]), -1, -1):
        moved = graph.ahead @ moved + weights[step] * belief
    return moved
