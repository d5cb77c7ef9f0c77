"""What the renderings of a map see, as harmonics over the columns."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from core.arrays import Float32Array, IntArray, frozen
from core.encodings.harmonics import as_real
from core.projection.visibility import seen_of_bits
from core.single_flight import single_flight_property, weakly

_KEPT = 8  # counts of harmonics: of queries and of estimates


class Seen:
    """The harmonics of 1 in the columns that each rendering sees and 0 elsewhere, as real numbers.

    Many renderings see alike: one row is kept of each way to see.

    Args:
        hidden_sectors: `(K, D)`, the bits of the sectors that each rendering does not see.
        columns: J.
        r2: How many harmonics a rendering has: of what it sees there are `2 r2 - 1`.
        slow: How many change little from one heading to the next.
        each: Whether to keep these of each rendering, 44 bytes.

    Attributes:
        slow: How many of them there are.
    """

    def __init__(
        self, hidden_sectors: IntArray, columns: int, r2: int, slow: int, *, each: bool
    ) -> None:
        self._hidden = hidden_sectors
        self._columns, self._harmonics, self._each = columns, 2 * r2 - 1, each
        self.slow = min(slow, self._harmonics)

    @single_flight_property
    def all(self) -> bool:
        """Whether no rendering has hidden sectors."""
        return not np.any(self._hidden)

    def harmonics(self, rows: IntArray, renderings: IntArray, count: int) -> Float32Array:
        """Return the first ones of some scans' renderings."""
        of_first, which = self._of_ways(count), self._ways[1]
        return np.asarray(of_first[:, which[renderings * len(self._hidden) + rows]])

    def waves(self, block: slice) -> Float32Array:
        """Return the slow ones of some renderings, in the order `(D, K)`."""
        if self._each:
            return np.asarray(self._of_each[:, block])
        return np.asarray(self._of_ways(self.slow)[:, self._ways[1][block]])

    @single_flight_property
    def _ways(self) -> tuple[Float32Array, NDArray[np.int32]]:
        """The harmonics of each way to see, and which of them each rendering has."""
        distinct, which = np.unique(self._hidden.T, return_inverse=True)
        seen = np.fft.rfft(seen_of_bits(distinct, self._columns).astype(np.float64), axis=-1)
        # Of real numbers those from J/2 on are the conjugates of those before, and J is even.
        seen = np.concatenate([seen, seen[:, -2:0:-1].conj()], axis=1)
        harmonics = seen[:, np.arange(self._harmonics) % self._columns] / self._columns
        return frozen(as_real(harmonics.T), np.float32), which.reshape(-1).astype(np.int32)

    @single_flight_property
    def _of_ways(self) -> Callable[[int], Float32Array]:
        """The first harmonics of each way to see, of how many."""
        return lru_cache(_KEPT)(weakly(self._first_of_ways))

    def _first_of_ways(self, count: int) -> Float32Array:
        real, imag = np.split(self._ways[0], [self._harmonics])
        return frozen(np.concatenate([real[:count], imag[: count - 1]]), np.float32)

    @single_flight_property
    def _of_each(self) -> Float32Array:
        return frozen(self._of_ways(self.slow)[:, self._ways[1]], np.float32)
