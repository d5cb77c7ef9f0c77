"""Where each place of a travel graph leads within some scans."""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from core.arrays import FloatArray, IntArray, frozen

if TYPE_CHECKING:
    from core.tracking.graph import TravelGraph

MAX_STEPS = 24
"""Most scans of the map that are passed between two observations."""


def places_of(rows: IntArray) -> IntArray:
    """Return the places of some scans, each in both directions, `(2 n,)`."""
    return np.asarray((2 * rows[:, None] + np.arange(2)).reshape(-1))


class Walks:
    """The places that are 0 to `MAX_STEPS` scans ahead of each place, and how probable each is.

    Args:
        graph: The places.
    """

    def __init__(self, graph: "TravelGraph") -> None:
        from scipy.sparse import eye_array, vstack  # only tracks need it: decision 33

        # Not the graph, which holds its walks: what refers to itself stays in memory for long.
        self._ahead, self._step_m = graph.ahead, graph.step_m
        power = eye_array(graph.places, format="csr")
        powers = [power]
        for _ in range(MAX_STEPS):
            power = graph.ahead @ power
            powers.append(power)
        walks = vstack(powers, format="csc")
        self._first: NDArray[np.integer] = walks.indptr
        steps, places = np.divmod(walks.indices, graph.places)
        self._steps, self._places = steps.astype(np.uint8), places.astype(np.int32)
        self._probability = frozen(walks.data, np.float64)

    @cached_property
    def length_m(self) -> FloatArray:
        """The mean length of so many steps from each place, `(MAX_STEPS + 1, 2K)`."""
        back = self._ahead.T.tocsr()
        length_m = np.zeros((MAX_STEPS + 1, len(self._step_m)))
        for step in range(MAX_STEPS):
            length_m[step + 1] = self._step_m + back @ length_m[step]
        return frozen(length_m, np.float64)

    def moved(
        self, begin: IntArray, at: FloatArray, weights: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """Return where walks from some places lead, and the probabilities after them.

        Args:
            begin: `(n,)` those places.
            at: `(n, P)` the probability of each, and of each pace.
            weights: `(MAX_STEPS + 1, n, P)` of each number of steps; n and P may be 1.

        Returns:
            `(m,)` the places that are reached, each in both directions, rising; and `(m, P)`.
        """
        first = self._first[begin]
        count = self._first[begin + 1] - first
        of_walk = np.repeat(np.arange(len(begin)), count)
        walk = np.arange(len(of_walk)) + np.repeat(first - np.cumsum(count) + count, count)
        steps, paces = self._steps.take(walk), at.shape[1]
        of_steps = weights[steps, 0 if weights.shape[1] == 1 else of_walk]
        shares = at.take(of_walk, axis=0)
        shares *= of_steps * self._probability.take(walk)[:, None]
        ends = self._places.take(walk)
        rows = ends >> 1
        is_reached = np.zeros(len(self._step_m) // 2, np.bool_)
        is_reached[rows] = True
        reached = np.flatnonzero(is_reached)
        number = np.empty(len(is_reached), np.intp)
        number[reached] = np.arange(len(reached))
        position = 2 * number.take(rows) + (ends & 1)
        cells = position[:, None] * np.intp(paces) + np.arange(paces)
        moved = np.bincount(cells.ravel(), shares.ravel(), 2 * len(reached) * paces)
        return places_of(reached), np.asarray(moved.reshape(-1, paces), np.float64)
