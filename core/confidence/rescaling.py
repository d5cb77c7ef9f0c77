"""Distances of queries that tell places apart less than those that calibrated their map."""

import math
from dataclasses import dataclass

import numpy as np

from core.arrays import FloatArray

_LEAST = 1e-12  # a distance of 0 has no logarithm
_MOST_LOG = 600.0  # exponentials stay finite, and above 0


@dataclass(frozen=True)
class Rescaling:
    """log d -> `shift` + `power` log d: distances of limited queries as those of the usual ones.

    The less is compared, the nearer is the nearest of the wrong places, and the more that differs
    between queries. Here a distance becomes the usual one of which wrong places have as
    many: mean and standard deviation of the logarithms are made equal.

    Attributes:
        shift: Added to the logarithm.
        power: Power of the distance, above 0 and at most 1: less is never more discriminative.
    """

    shift: float
    power: float

    @classmethod
    def of_wrong_places(cls, fewer: FloatArray, usual: FloatArray) -> "Rescaling":
        """Return the rescaling of a map by the same scans as queries, with either numbers.

        Args:
            fewer: `(n,)` distance to the nearest scan elsewhere, at least one.
            usual: `(n,)` the same by the usual numbers.
        """
        log_fewer, log_usual = (np.log(np.maximum(found, _LEAST)) for found in (fewer, usual))
        varies = float(log_fewer.std())
        # Where all places are equally near, as by one number, a distance carries no information.
        power = min(1.0, float(log_usual.std()) / varies) if varies > 0.0 else 0.0
        power = max(power, _LEAST)
        return cls(float(log_usual.mean() - power * log_fewer.mean()), power)

    def weighted(self, weight: float) -> "Rescaling":
        """Return the rescaling of which so much applies to logarithms, from none, 0, to all, 1.

        Examples:
            >>> Rescaling(shift=1.0, power=0.5).weighted(0.5)
            Rescaling(shift=0.5, power=0.75)
        """
        return Rescaling(weight * self.shift, 1.0 - weight * (1.0 - self.power))

    def of(self, distances: FloatArray) -> FloatArray:
        """Return distances by the usual numbers, of any shape; infinite ones stay infinite.

        Examples:
            >>> Rescaling(shift=0.0, power=0.5).of(np.array([0.01, np.inf])).tolist()
            [0.1, inf]
        """
        return np.asarray(math.exp(self.shift) * np.maximum(distances, _LEAST) ** self.power)

    def inverse(self, usual: float) -> float:
        """Return the distance by the fewer numbers that `of` makes this one, above 0.

        Examples:
            >>> round(Rescaling(shift=0.0, power=0.5).inverse(0.1), 9)
            0.01
        """
        found = (math.log(usual) - self.shift) / self.power
        return math.exp(min(max(found, -_MOST_LOG), _MOST_LOG))
