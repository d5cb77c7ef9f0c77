"""Logistic regression with finite weights for separable classes."""

import math

import numpy as np

from core.arrays import BoolArray, FloatArray
from core.errors import InvalidParameters

_RIDGE = 1.0  # of slopes in standard deviations of their feature, against one sample's loss
_EXP_FROM = -700.0  # e^-odds is a number from here on, and 1 does not count before


def logistic(odds: float) -> float:
    """Return the probability of log-odds, 1 / (1 + e^-odds).

    SciPy's `expit` is the same and has to be imported: 30 MB (docs/decisions/0033-hot-path.md).

    Examples:
        >>> logistic(0.0), logistic(-1e9), logistic(1e9)
        (0.5, 0.0, 1.0)
    """
    return 1.0 / (1.0 + math.exp(-odds)) if odds > _EXP_FROM else math.exp(odds)


def fit_logistic(
    features: FloatArray, right: BoolArray, at_most: FloatArray, known: FloatArray | float = 0.0
) -> FloatArray:
    """Fit log-odds = w_0 + sum w_i x_i to right and wrong samples.

    The weights are finite for separable classes too: slopes have a ridge, and the targets are
    (n_right + 1) / (n_right + 2) and 1 / (n_wrong + 2) as with a uniform prior (Platt, 1999).

    Args:
        features: `(n, f)`, finite.
        right: `(n,)`, with at least one right and one wrong sample.
        at_most: `(f,)` the greatest slopes; infinite where any may be.
        known: `(n,)` log-odds that are known already, to which these are added.

    Returns:
        `(1 + f,)` the intercept and the slopes.

    Raises:
        InvalidParameters: If the shapes differ, a feature is not finite, or all samples are right
            or all wrong.

    Examples:
        >>> distance = np.array([[0.1], [0.2], [0.8], [0.9]])
        >>> right = np.array([True, True, False, False])
        >>> intercept, slope = fit_logistic(distance, right, np.zeros(1))
        >>> bool(slope < 0.0), round(float(-intercept / slope), 3)
        (True, 0.5)
    """
    from scipy.optimize import minimize  # takes long to import, and only builds need it
    from scipy.special import expit

    samples, count = features.shape
    if right.shape != (samples,) or at_most.shape != (count,):
        raise InvalidParameters(
            f"features {features.shape}, right {right.shape} and at_most {at_most.shape} do not"
            " fit together"
        )
    if not np.isfinite(features).all():
        raise InvalidParameters("a feature is not finite")
    of_right = int(right.sum())
    if of_right in {0, samples}:
        raise InvalidParameters(f"{of_right} of {samples} samples are right: both kinds are wanted")
    target = np.where(right, (of_right + 1) / (of_right + 2), 1 / (samples - of_right + 2))
    mean, scale = features.mean(axis=0), features.std(axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    design = np.column_stack([np.ones(samples), (features - mean) / scale])
    ridge = np.array([0.0, *[_RIDGE] * count])

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        odds = known + design @ weights
        value = (np.logaddexp(0.0, odds) - target * odds).sum() + 0.5 * ridge @ weights**2
        return float(value), design.T @ (expit(odds) - target) + ridge * weights

    bounds = [(None, None), *((None, most) for most in (at_most * scale).tolist())]
    found = minimize(loss, np.zeros(1 + count), jac=True, method="L-BFGS-B", bounds=bounds)
    slopes = found.x[1:] / scale
    return np.array([found.x[0] - slopes @ mean, *slopes])
