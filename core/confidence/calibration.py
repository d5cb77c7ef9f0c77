"""Calibration: from distances to probabilities, learned from a map's own scans at build time."""

import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from core.arrays import FloatArray
from core.attributes import Attributes
from core.confidence.logistic import logistic
from core.confidence.rescaling import Rescaling
from core.confidence.spread import Spread
from core.errors import InvalidParameters
from core.numbers import require_above

MIN_PROBABILITY = 0.5
"""Default threshold: a match that is more likely wrong than right is refused."""

_MOST_CELLS = 4_000_000  # as of a grid
_LARGEST = 1e12  # of a coefficient: with any distance that has a logarithm, sums stay finite
_SURE = 1.0 - 2.0**-53  # the largest float64 below 1: no probability is 1
_HALF = math.sqrt(0.5)  # evidence: of half the cells
_LITTLE, _MOST_OF_LITTLE = 0.5, 0.99  # of a quarter of a view: docs/decisions/0030-any-view.md


@dataclass(frozen=True)
class Calibration(Attributes):
    """From distances to probabilities, by logistic regressions on logarithms.

    Distances are in the map's own measure, taken as log(distance + `floor`). The prior odds are
    even: half of the probes that this was fitted to have their place in the map.

    Attributes:
        floor: Added to every distance, above 0; differences below it have little effect.
        both: Intercept, slope of the best distance's logarithm and slope of its ratio to the
            runner-up's; slopes are at most 0.
        alone: Intercept and slope where there is no runner-up.
        likelihood: Intercept and slope of the log-likelihood ratio of a single scan's distance.
        threshold: Below this probability an answer is a refusal, 0..1.
        least_cells: An image with fewer occupied cells is refused.
        spread: Errors of right answers; `None` where poses are unknown.
        evidence: `Search.evidence` of the probes that this was fitted to, above 0 and at most 1:
            less of a sensor that never sees all around, or not far.
        with_signature: Of queries that images are compared with too: intercept, and slopes of these
            log-odds, at least 0, and of those by signature alone, above 0; `None` if only the first
            count.
    """

    floor: float
    both: tuple[float, float, float]
    alone: tuple[float, float]
    likelihood: tuple[float, float]
    threshold: float = MIN_PROBABILITY
    least_cells: int = 0
    spread: Spread | None = None
    evidence: float = 1.0
    with_signature: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        for name, count in (("both", 3), ("alone", 2), ("likelihood", 2)):
            self._set_numbers(name, count, -_LARGEST, _LARGEST)
            if max(values := getattr(self, name)[1:]) > 0.0:
                raise InvalidParameters(f"slopes of {name} are {values}, wanted at most 0")
        object.__setattr__(self, "floor", float(self.floor))
        object.__setattr__(self, "threshold", float(self.threshold))
        require_above(0, floor=self.floor)
        if not 0.0 <= self.threshold <= 1.0:
            raise InvalidParameters(f"threshold is {self.threshold}, wanted 0..1")
        object.__setattr__(self, "least_cells", operator.index(self.least_cells))
        if not 0 <= self.least_cells <= _MOST_CELLS:
            raise InvalidParameters(f"least_cells is {self.least_cells}, wanted 0..{_MOST_CELLS}")
        object.__setattr__(self, "evidence", float(self.evidence))
        if not 0.0 < self.evidence <= 1.0:
            raise InvalidParameters(f"evidence is {self.evidence}, wanted above 0 and at most 1")
        if self.with_signature is not None:
            self._set_numbers("with_signature", 3, -_LARGEST, _LARGEST)
            _, of_images, of_signature = self.with_signature
            if of_images < 0.0 or of_signature <= 0.0:
                raise InvalidParameters(
                    f"slopes of with_signature are {of_images} and {of_signature}, wanted at least"
                    " 0 and above 0"
                )

    def probability(
        self,
        distance: float,
        ratio: float | None,
        share: float = 1.0,
        evidence: float = 1.0,
        odds_of_signature: float | None = None,
    ) -> float:
        """Return the probability that the best match is right, above 0 and below 1.

        With a share s of the places searched, wrong matches this near are s times as frequent, so
        the odds are divided by s, up to those of a single scan's likelihood ratio.

        Args:
            distance: The best match's distance, at least 0.
            ratio: The ratio of that to the runner-up's distance, 0..1, `None` without one.
            share: The share of the map's places that were searched, above 0 and at most 1.
            evidence: The query's `Search.evidence`: the logarithm of the odds counts as much as
                `relative_evidence` says. Below a half, no probability is above 0.99.
            odds_of_signature: The logarithm of the odds of the same match by the signature alone,
                `None` where it is not known. Without a ratio it does not count.

        Raises:
            InvalidParameters: If one is NaN or out of its range.

        Examples:
            >>> trust = Calibration(0.001, (-5.0, -3.0, -5.0), (-9.0, -3.5), (-9.0, -3.5))
            >>> round(trust.probability(0.02, 0.3), 3), round(trust.probability(0.2, 0.9), 3)
            (0.994, 0.009)
        """
        if not 0.0 < share <= 1.0:
            raise InvalidParameters(f"share is {share}, wanted above 0 and at most 1")
        odds = self.log_odds(distance, ratio)
        if self.with_signature and ratio is not None and odds_of_signature is not None:
            intercept, of_images, of_signature = self.with_signature
            odds = intercept + _times(of_images, odds) + of_signature * odds_of_signature
        # The odds of a single scan are its likelihood ratio: no share raises them above that.
        alone = float(self.log_likelihood_ratio(np.array(distance)))
        odds = max(odds, min(odds - math.log(share), alone))
        return self._probability(odds, evidence)

    def probability_of_scan(self, distance: float, evidence: float = 1.0) -> float:
        """Return the probability that a query was recorded at one scan, above 0 and below 1.

        That it was, and that it was elsewhere, are equally likely before the distance is known.

        Args:
            distance: From that scan, at least 0; infinite if it was not compared.
            evidence: As in `probability`.
        """
        log_odds = float(self.log_likelihood_ratio(np.array(distance)))
        return self._probability(log_odds, evidence)

    def relative_evidence(self, evidence: float) -> float:
        """Return how much a query's distances say beside those that this was fitted to, 0..1.

        Examples:
            >>> narrow = Calibration(1.0, (0.0, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0), evidence=0.5)
            >>> narrow.relative_evidence(0.25), narrow.relative_evidence(1.0)
            (0.5, 1.0)
        """
        return min(evidence / self.evidence, 1.0)

    def counts_signature(self, evidence: float, *, short_reach: bool) -> bool:
        """Return whether what a query's signature says counts beside its images.

        Signatures of a short reach are farther from all scans than those that this was fitted to:
        they count only if the query sees at least half of what the probes see. How narrow its field
        of view is changes them little.

        Args:
            evidence: As in `probability`.
            short_reach: `Search.short_reach` of the query.
        """
        if self.with_signature is None:
            return False
        return not short_reach or self.relative_evidence(evidence) >= _HALF

    def _probability(self, log_odds: float, evidence: float) -> float:
        most = _MOST_OF_LITTLE if evidence < _LITTLE else _SURE
        found = logistic(self.relative_evidence(evidence) * log_odds)
        return min(max(found, math.ulp(0.0)), most)

    def log_odds(self, distance: float, ratio: float | None) -> float:
        """Return the logarithm of the odds that the best match of a whole map is right.

        Args:
            distance: As in `probability`.
            ratio: As in `probability`.

        Raises:
            InvalidParameters: If one is NaN or out of its range.
        """
        if not distance >= 0.0:
            raise InvalidParameters(f"distance is {distance}, wanted at least 0")
        far = math.log(distance + self.floor)
        if ratio is None:
            return self.alone[0] + _times(self.alone[1], far)
        if not 0.0 <= ratio <= 1.0:
            raise InvalidParameters(f"ratio is {ratio}, wanted 0..1")
        return self.both[0] + _times(self.both[1], far) + self.both[2] * ratio

    def lowered(self, by: float) -> "Calibration":
        """Return the calibration whose logarithms of odds are lower by so much.

        Examples:
            >>> trust = Calibration(0.001, (-5.0, -3.0, -5.0), (-9.0, -3.5), (-9.0, -3.5))
            >>> round(trust.log_odds(0.02, 0.3) - trust.lowered(2.0).log_odds(0.02, 0.3), 9)
            2.0
        """
        both, alone, likelihood = (
            (line[0] - by, *line[1:]) for line in (self.both, self.alone, self.likelihood)
        )
        with_signature = self.with_signature
        if with_signature is not None:
            intercept, of_images, of_signature = with_signature
            with_signature = (intercept - (1.0 - of_images) * by, of_images, of_signature)
        return replace(
            self, both=both, alone=alone, likelihood=likelihood, with_signature=with_signature
        )

    def rescaled(self, by: Rescaling) -> "Calibration":
        """Return the calibration of distances that a rescaling makes those of this one.

        Ratios count as they are: the rescaled distances already account for the fewer numbers.
        """
        return replace(
            self,
            floor=by.inverse(self.floor),
            both=(*_rescaled(self.both[:2], by), self.both[2]),
            alone=_rescaled(self.alone, by),
            likelihood=_rescaled(self.likelihood, by),
            spread=None if self.spread is None else self.spread.rescaled(by),
        )

    def log_likelihood_ratio(self, distances: FloatArray) -> FloatArray:
        """Return log p(d | the query is at this scan) - log p(d | elsewhere), of any shape.

        The ratio of an infinite distance, of a scan that was not compared, is minus infinity; where
        the slope is 0, all ratios are the intercept.
        """
        intercept, slope = self.likelihood
        if slope == 0.0:
            return np.full(distances.shape, intercept)
        return np.asarray(intercept + slope * np.log(distances + self.floor))

    def as_attributes(self) -> dict[str, Any]:
        """Return plain values for a file's attributes, without those that change nothing."""
        attributes = super().as_attributes()
        # As of all maps of releases that did not know them.
        if self.evidence == 1.0:
            del attributes["evidence"]
        if self.with_signature is None:
            del attributes["with_signature"]
        return attributes

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, Any]) -> Self:
        """Read the values of `as_attributes`.

        Raises:
            InvalidMap: If a value is missing, unknown or of another type.
        """
        if (spread := attributes.get("spread")) is not None:
            attributes = {**attributes, "spread": Spread.from_attributes(spread)}
        return super().from_attributes({"evidence": 1.0, "with_signature": None, **attributes})


def distance_ratio(best: float, runner_up: float) -> float:
    """Return the ratio of two distances, at most 1; 1 where the query equals the runner-up."""
    return 1.0 if runner_up == 0.0 else min(1.0, best / runner_up)


def _times(slope: float, far: float) -> float:
    """Return a product that is 0 where the slope is, also of an infinite distance."""
    return slope * far if slope else 0.0


def _rescaled(line: tuple[float, float], by: Rescaling) -> tuple[float, float]:
    intercept, slope = line
    return intercept + slope * by.shift, slope * by.power
