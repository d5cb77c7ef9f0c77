"""Standard deviations of right answers."""

import itertools

import numpy as np
import pytest

from core.confidence.spread import Spread, fit_heading_variance, fit_variance


def log_loss(errors, grows, a, b):
    variance = a**2 + (b * grows) ** 2
    return float(np.sum(np.log(variance) + errors**2 / variance))


@pytest.mark.parametrize("seed", [0, 1, 23, 35, 106, 150, 229])
def test_no_other_variances_are_much_likelier_also_with_a_few_large_errors(seed):
    # Errors of decimetres along a street, and a few that are nearly too large to be right.
    rng = np.random.default_rng(seed)
    grows = rng.lognormal(-1.0, 0.7, 100)
    errors = rng.normal(scale=np.hypot(0.3, 0.3 * grows))
    large = rng.choice(100, 1 + seed % 4, replace=False)
    errors[large] = rng.uniform(6.0, 9.5, len(large))
    found = log_loss(errors, grows, *fit_variance(errors, grows))
    others = itertools.product(np.geomspace(0.003, 30.0, 41), repeat=2)
    assert found <= min(log_loss(errors, grows, a, b) for a, b in others) + 0.1


def test_no_heading_is_less_certain_than_one_of_which_nothing_is_known():
    spread = Spread(typical=0.01, along_m=(0.1, 1.0), lateral_m=(0.1, 0.2), heading_deg=(1.0, 0.5))
    exact, bad = spread.deviation(0.02, 1.0), spread.deviation(1e4, 1.0)
    assert exact.heading_deg == pytest.approx(np.hypot(1.0, 0.5 * 2.0))
    uniform = np.linspace(-180.0, 180.0, 100_001)
    assert bad.heading_deg == pytest.approx(uniform.std(), rel=1e-4)


def test_an_answer_nearer_than_typical_is_not_taken_for_more_exact():
    spread = Spread(typical=0.01, along_m=(0.1, 1.0), lateral_m=(0.1, 0.2), heading_deg=(1.0, 0.5))
    assert spread.deviation(0.001, 1.0) == spread.deviation(0.01, 1.0)


@pytest.mark.parametrize(
    ("opposed", "least_deg", "most_deg"), [(0, 0.9, 1.1), (5, 0.9, 1.1), (6, 30.0, 60.0)]
)
def test_a_few_opposed_headings_do_not_widen_all_others(opposed, least_deg, most_deg):
    rng = np.random.default_rng(3)
    errors_deg, far = rng.normal(size=100), np.maximum(1.0, rng.normal(1.0, 0.4, 100))
    errors_deg[:opposed] += 178.0
    constant, growing = fit_heading_variance(errors_deg, far)
    assert least_deg < np.hypot(constant, growing) < most_deg
