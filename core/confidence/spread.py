"""Standard deviations of right answers: along the path, across it, and in heading."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from core.arrays import FloatArray
from core.attributes import Attributes
from core.confidence.rescaling import Rescaling
from core.numbers import require_at_least

# Deviations and their squares stay finite: a distance over the least typical one is below 1e110.
_LEAST_TYPICAL, _LARGEST = 1e-30, 1e12
_OF_ANY_HEADING_DEG = 180.0 / math.sqrt(3.0)  # the standard deviation of a uniform one
_LEAST_EVIDENCE = 0.1  # with less than 0.29 an answer is refused
_LEAST_RELATIVE = 1e-3  # of the errors' root mean square: no standard deviation is 0
_MEDIANS = 10.0  # 6.7 standard deviations of a normal distribution
# With a sixth of stray headings, what all count to covers as much too many as their leaving out
# covers too few: docs/reference/trust-measurements.md#stray-headings.
_MOST_STRAY = 1.0 / 6.0
_GROWING = 1.0 / (1.0 + np.geomspace(1e5, 1e-5, 21))  # share of the growing part of the variance
_LIKELIER = 0.01  # of twice the log-likelihood: what is not more is rounding


class Covariance(NamedTuple):
    """The covariance of a position, in the map's frame."""

    xx_m2: float
    xy_m2: float
    yy_m2: float


@dataclass(frozen=True)
class Deviation:
    """Standard deviations of an estimated pose, along and across the path of the matched scan.

    A vehicle in the same lane has these axes too; one that crosses the path has others.

    Attributes:
        along_m: Along the path, forward and backward.
        lateral_m: Across it, to the left and right.
        heading_deg: The heading's deviation, at most that of a heading of which nothing is known.
    """

    along_m: float
    lateral_m: float
    heading_deg: float

    def of_less(self, evidence: float) -> "Deviation":
        """Return the deviation of a query that sees less than those that this is of.

        The fewer cells a query has, the less exact is its place, as the mean of fewer measurements.

        Args:
            evidence: `Calibration.relative_evidence`: the root of the share of cells, 0..1.

        Examples:
            >>> Deviation(1.0, 0.5, 2.0).of_less(0.5)
            Deviation(along_m=2.0, lateral_m=1.0, heading_deg=4.0)
        """
        evidence = max(evidence, _LEAST_EVIDENCE)
        return Deviation(
            self.along_m / evidence,
            self.lateral_m / evidence,
            min(self.heading_deg / evidence, _OF_ANY_HEADING_DEG),
        )

    def covariance_m2(self, heading_deg: float) -> Covariance:
        """Return the covariance of the position in the map's frame.

        Args:
            heading_deg: The matched scan's heading in the map, counter-clockwise from x.

        Examples:
            >>> xx, xy, yy = Deviation(2.0, 0.5, 1.0).covariance_m2(90.0)
            >>> round(xx, 9), round(xy, 9), round(yy, 9)
            (0.25, 0.0, 4.0)
        """
        cos, sin = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))
        along, lateral = self.along_m**2, self.lateral_m**2
        return Covariance(
            along * cos * cos + lateral * sin * sin,
            (along - lateral) * cos * sin,
            along * sin * sin + lateral * cos * cos,
        )


@dataclass(frozen=True)
class Spread(Attributes):
    """Variances as a constant and a part that grows: s^2 = a^2 + (b x)^2.

    Along the path x is the spread of the scans around the best match that fit the query. Across it
    and in heading x is the best distance divided by a typical one, at least 1: a match nearer than
    typical is not taken for more exact.

    Attributes:
        typical: A right answer's median distance, above 0.
        along_m: a in metres, b a number.
        lateral_m: a and b in metres.
        heading_deg: a and b in degrees.
    """

    typical: float
    along_m: tuple[float, float]
    lateral_m: tuple[float, float]
    heading_deg: tuple[float, float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "typical", float(self.typical))
        require_at_least(_LEAST_TYPICAL, typical=self.typical)
        for name in ("along_m", "lateral_m", "heading_deg"):
            self._set_numbers(name, 2, 0.0, _LARGEST)

    def rescaled(self, by: Rescaling) -> "Spread":
        """Return the spread of distances that become those of this one by a rescaling."""
        return replace(self, typical=max(by.inverse(self.typical), _LEAST_TYPICAL))

    def deviation(self, distance: float, spread_m: float) -> Deviation:
        """Return the standard deviations of an answer.

        Args:
            distance: The best match's distance.
            spread_m: The spread of the scans around it: `along_spread_m`.
        """
        far = max(1.0, distance / self.typical)
        return Deviation(
            math.hypot(self.along_m[0], self.along_m[1] * spread_m),
            math.hypot(self.lateral_m[0], self.lateral_m[1] * far),
            min(math.hypot(self.heading_deg[0], self.heading_deg[1] * far), _OF_ANY_HEADING_DEG),
        )


def along_spread_m(along_m: FloatArray, log_likelihood: FloatArray) -> float:
    """Return the spread of scans along the path, weighted by their likelihood.

    Args:
        along_m: `(n,)` positions of the scans along the path, at least one.
        log_likelihood: `(n,)` log-likelihood ratios of their distances.

    Examples:
        >>> along_spread_m(np.array([-1.0, 0.0, 1.0]), np.array([0.0, 30.0, 0.0])) < 1e-5
        True
        >>> along_spread_m(np.array([-1.0, 1.0]), np.array([2.0, 2.0]))
        1.0
    """
    weights = np.exp(log_likelihood - log_likelihood.max())
    weights /= weights.sum()
    mean_m = weights @ along_m
    return float(np.sqrt(weights @ (along_m - mean_m) ** 2))


def fit_variance(errors: FloatArray, grows: FloatArray) -> tuple[float, float]:
    """Return the most likely a and b of errors with variance a^2 + (b x)^2.

    Args:
        errors: `(n,)` at least one, of mean 0.
        grows: `(n,)` x, at least 0.

    Examples:
        >>> rng = np.random.default_rng(0)
        >>> x = rng.uniform(0.0, 2.0, 10_000)
        >>> a, b = fit_variance(rng.normal(scale=np.hypot(0.5, 1.5 * x)), x)
        >>> round(a, 1), round(b, 1)
        (0.5, 1.5)
    """
    from scipy.optimize import minimize  # takes long to import, and only builds need it

    total = float(np.mean(errors**2))
    if total == 0.0:
        return 0.0, 0.0
    least = _LEAST_RELATIVE**2 * total
    scale = float(np.mean(grows**2)) or 1.0

    def loss(parts: FloatArray) -> float:
        variance = least + total * (parts[0] + parts[1] * grows**2 / scale)
        return float(np.sum(np.log(variance) + errors**2 / variance))

    def fitted_from(start: FloatArray) -> tuple[float, FloatArray]:
        found = minimize(loss, start, method="L-BFGS-B", bounds=[(0.0, None)] * 2)
        return float(found.fun), np.asarray(found.x)

    least_loss, parts = fitted_from(np.array([0.5, 0.5]))
    # With a few large errors that may be one of several minima.
    other_loss, others = fitted_from(_likeliest_mixture(errors**2 / total, grows**2 / scale, loss))
    constant, growing = (others if other_loss < least_loss - _LIKELIER else parts).tolist()
    return math.sqrt(least + total * constant), math.sqrt(total * growing / scale)


def fit_heading_variance(errors_deg: FloatArray, grows: FloatArray) -> tuple[float, float]:
    """Return `fit_variance` of headings, without stray ones if these are few.

    An error of more than ten medians, as of a vehicle that is taken for one in the opposite
    direction, is another mistake than an inexact heading: one of 92 made the deviation of every
    answer 12 degrees where errors had 1. Where more than a sixth are, no heading is certain, and
    all count, as where most errors are 0.

    Args:
        errors_deg: `(n,)` at least one, of mean 0, -180 to 180.
        grows: `(n,)` x, at least 0.

    Examples:
        >>> errors_deg = np.tile([1.0, -1.0], 10)
        >>> errors_deg[:3] = 179.0, -40.0, 178.0
        >>> a, b = fit_heading_variance(errors_deg, np.zeros(20))
        >>> round(a, 1)
        1.0
    """
    sizes_deg = np.abs(errors_deg)
    median_deg = np.median(sizes_deg)
    exact = sizes_deg <= _MEDIANS * median_deg
    if median_deg == 0.0 or np.mean(exact) < 1.0 - _MOST_STRAY:
        return fit_variance(errors_deg, grows)
    return fit_variance(errors_deg[exact], grows[exact])


def _likeliest_mixture(
    squares: FloatArray, growth: FloatArray, loss: Callable[[FloatArray], float]
) -> FloatArray:
    """Return the parts of the variance of the likeliest of some mixtures, `(2,)`.

    Args:
        squares: `(n,)` of the errors, of mean 1.
        growth: `(n,)` of the growing part.
        loss: The loss of two parts of the variance.
    """
    mixtures = np.column_stack([1.0 - _GROWING, _GROWING])
    # Of variances in given proportions, the likeliest have a mean square of the errors of 1.
    sizes = (squares / (mixtures @ np.stack([np.ones_like(growth), growth]))).mean(axis=1)
    return np.asarray(min(sizes[:, None] * mixtures, key=loss))
