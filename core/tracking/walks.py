"""Where each place of a travel graph leads within some strides."""

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from core.arrays import FloatArray, IntArray, frozen

if TYPE_CHECKING:
    from core.tracking.graph import TravelGraph
    from core.tracking.strides import Steps

MAX_STRIDES = 24
"""Most strides between two observations."""

LEAST_WEIGHT = 1e-9
"""Numbers of strides that have at most this weight are left out."""

_LAST = np.array([0.0, 1.0])[:, None, None]  # weights of staying and of a last stride


def places_of(rows: IntArray) -> IntArray:
    """Return the places of some scans, each in both directions, `(2 n,)`."""
    return np.asarray((2 * rows[:, None] + np.arange(2)).reshape(-1))


class _Ways:
    """The places that some numbers of strides lead to from each place, and how probable each is.

    Args:
        ahead: Of each number the probability of a place (row) after another (column).
    """

    def __init__(self, ahead: "Sequence[Steps]") -> None:
        from scipy.sparse import vstack  # only tracks need it: decision 33

        self._ends = ahead[0].shape[0]
        ways = vstack(ahead, format="csc")
        self._first: NDArray[np.integer] = ways.indptr
        counts, places = np.divmod(ways.indices, self._ends)
        self._count, self._places = counts.astype(np.uint8), places.astype(np.int32)
        self._probability = frozen(ways.data, np.float64)

    def moved(
        self, begin: IntArray, at: FloatArray, weights: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """Return where they lead from some places: see `Walks.moved`."""
        first = self._first[begin]
        count = self._first[begin + 1] - first
        of_way = np.repeat(np.arange(len(begin)), count)
        way = np.arange(len(of_way)) + np.repeat(first - np.cumsum(count) + count, count)
        is_reached = np.zeros(self._ends // 2, np.bool_)
        is_reached[self._places.take(way) >> 1] = True  # by whatever weights
        reached = np.flatnonzero(is_reached)
        number = np.empty(len(is_reached), np.intp)
        number[reached] = np.arange(len(reached))
        counts, paces = self._count.take(way), at.shape[1]
        weighs = weights.max(axis=2) > LEAST_WEIGHT
        if not weighs.all():
            kept = weighs[counts, 0 if weights.shape[1] == 1 else of_way]
            of_way, way, counts = of_way[kept], way[kept], counts[kept]
        of_counts = weights[counts, 0 if weights.shape[1] == 1 else of_way]
        shares = at.take(of_way, axis=0)
        shares *= of_counts * self._probability.take(way)[:, None]
        ends = self._places.take(way)
        position = 2 * number.take(ends >> 1) + (ends & 1)
        cells = position[:, None] * np.intp(paces) + np.arange(paces)
        moved = np.bincount(cells.ravel(), shares.ravel(), 2 * len(reached) * paces)
        return places_of(reached), np.asarray(moved.reshape(-1, paces), np.float64)


class Walks:
    """The places that are 0 to `MAX_STRIDES` ahead of each place, and how probable each is.

    Args:
        graph: The places.
    """

    def __init__(self, graph: "TravelGraph") -> None:
        from scipy.sparse import eye_array  # only tracks need it: decision 33

        # Not the graph, which holds its walks: what refers to itself stays in memory for long.
        self._strides = strides = graph.strides
        ahead = [eye_array(graph.places, format="csr")]
        for _ in range(MAX_STRIDES):
            ahead.append(strides.ahead @ ahead[-1])
        self._last: _Ways | None = None
        if strides.last is not strides.ahead:
            # Apart from the others: a product of both has as many entries as both have times each.
            self._last = _Ways([ahead[0], strides.last])
            ahead.pop()
        self._ways = _Ways(ahead)

    @cached_property
    def length_m(self) -> FloatArray:
        """The mean length of so many strides from each place, `(MAX_STRIDES + 1, 2K)`."""
        strides = self._strides
        back = strides.ahead.T.tocsr()
        length_m = np.zeros((MAX_STRIDES + 1, len(strides.last_m)))
        length_m[1] = strides.last_m
        for count in range(1, MAX_STRIDES):
            length_m[count + 1] = strides.ahead_m + back @ length_m[count]
        return frozen(length_m, np.float64)

    def moved(
        self, begin: IntArray, at: FloatArray, weights: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """Return where walks from some places lead, and the probabilities after them.

        Args:
            begin: `(n,)` those places.
            at: `(n, P)` the probability of each, and of each pace.
            weights: `(MAX_STRIDES + 1, n, P)` of each number of strides; n and P may be 1.

        Returns:
            `(m,)` the places that are reached, each in both directions, rising; and `(m, P)`.
        """
        if self._last is None:
            return self._ways.moved(begin, at, weights)
        before, moved = self._ways.moved(begin, at, weights[1:])
        reached, moved = self._last.moved(before, moved, _LAST)
        moved[reached.searchsorted(begin)] += weights[0] * at
        return reached, moved
