"""How far a map's answers can be trusted, learned from its own scans when it was built."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from scipy.special import expit

from core.arrays import FloatArray
from core.errors import InvalidMap, InvalidParameters

__all__ = ["MIN_PROBABILITY", "Calibration"]

MIN_PROBABILITY = 0.5
"""An answer that is more likely wrong than right is none."""

_SURE = 1.0 - 2.0**-53  # the largest float64 below 1: no answer is beyond doubt


@dataclass(frozen=True)
class Calibration:
    """From distances to probabilities, by logistic regressions on logarithms.

    Distances are in the map's own measure, taken as log(distance + `floor`). A query is taken to
    be as likely in the map as elsewhere, as the scans that this was learned from were.

    Attributes:
        floor: Added to every distance, above 0: differences below it say nothing.
        both: Intercept, slope of the best distance's logarithm and slope of that of its ratio to
            the runner-up's; slopes are at most 0.
        alone: Intercept and slope where there is no runner-up.
        likelihood: Intercept and slope of the log-likelihood ratio of a single scan's distance.
        threshold: Below this probability an answer is a refusal, 0..1.
    """

    floor: float
    both: tuple[float, float, float]
    alone: tuple[float, float]
    likelihood: tuple[float, float]
    threshold: float = MIN_PROBABILITY

    def __post_init__(self) -> None:
        for name, length in (("both", 3), ("alone", 2), ("likelihood", 2)):
            values = tuple(float(value) for value in getattr(self, name))
            object.__setattr__(self, name, values)
            if len(values) != length or not all(map(math.isfinite, values)):
                raise InvalidParameters(f"{name} is {values}, wanted {length} finite numbers")
            if any(slope > 0.0 for slope in values[1:]):
                raise InvalidParameters(f"{name} is {values}: a greater distance speaks against")
        object.__setattr__(self, "floor", float(self.floor))
        object.__setattr__(self, "threshold", float(self.threshold))
        if not (math.isfinite(self.floor) and self.floor > 0.0):
            raise InvalidParameters(f"floor is {self.floor}, wanted above 0")
        if not 0.0 <= self.threshold <= 1.0:
            raise InvalidParameters(f"threshold is {self.threshold}, wanted 0..1")

    def probability(self, distance: float, ratio: float | None) -> float:
        """Return how likely the best match is right, above 0 and below 1.

        Args:
            distance: Of the best match, at least 0.
            ratio: Of it to that of the runner-up away from it, 0..1, `None` without one.

        Raises:
            InvalidParameters: If one is NaN or out of its range.

        Examples:
            >>> trust = Calibration(0.001, (-9.0, -3.0, -2.0), (-9.0, -3.5), (-9.0, -3.5))
            >>> round(trust.probability(0.02, 0.3), 3), round(trust.probability(0.2, 0.9), 3)
            (0.993, 0.018)
        """
        if not distance >= 0.0:
            raise InvalidParameters(f"distance is {distance}, wanted at least 0")
        far = math.log(distance + self.floor)
        if ratio is None:
            odds = self.alone[0] + self.alone[1] * far
        elif 0.0 <= ratio <= 1.0:
            # A ratio of exactly 0 is a distance of 0, which the floor keeps from being certain.
            alike = math.log(max(ratio, self.floor / (distance + self.floor)))
            odds = self.both[0] + self.both[1] * far + self.both[2] * alike
        else:
            raise InvalidParameters(f"ratio is {ratio}, wanted 0..1")
        return min(max(float(expit(odds)), math.ulp(0.0)), _SURE)

    def log_likelihood_ratio(self, distances: FloatArray) -> FloatArray:
        """Return log p(d | the query is at this scan) - log p(d | elsewhere), of any shape.

        An infinite distance, of a scan that was not compared, gives minus infinity, or 0 where
        distances tell nothing at all.
        """
        intercept, slope = self.likelihood
        if slope == 0.0:
            return np.full(distances.shape, intercept)
        return np.asarray(intercept + slope * np.log(distances + self.floor))

    def as_attributes(self) -> dict[str, Any]:
        """Return plain values for a file's attributes."""
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in asdict(self).items()
        }

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, Any]) -> "Calibration":
        """Read what `as_attributes` gave.

        Raises:
            InvalidMap: If something is missing, unknown or not of its kind.
        """
        try:
            odd = set(attributes) ^ {field.name for field in fields(cls)}
            if odd:
                raise ValueError(f"it lacks or should not hold {', '.join(sorted(odd))}")
            return cls(**attributes)
        except (TypeError, ValueError, OverflowError, InvalidParameters) as error:
            raise InvalidMap(f"the map's calibration cannot be read: {error}") from error
