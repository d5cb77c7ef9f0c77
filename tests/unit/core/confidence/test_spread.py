"""Standard deviations of right answers."""

import itertools

import numpy as np
import pytest

from core.confidence.spread import Deviation, Spread, fit_heading_variance, fit_variance


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


def test_a_query_that_sees_nothing_has_a_finite_deviation():
    least = Deviation(1.0, 0.5, 20.0).of_less(0.0)
    assert (least.along_m, least.lateral_m) == (10.0, 5.0)
    assert least.heading_deg == pytest.approx(180.0 / np.sqrt(3.0))


def test_an_answer_nearer_than_typical_is_not_taken_for_more_exact():
    spread = Spread(typical=0.01, along_m=(0.1, 1.0), lateral_m=(0.1, 0.2), heading_deg=(1.0, 0.5))
    assert spread.deviation(0.001, 1.0) == spread.deviation(0.01, 1.0)


@pytest.mark.parametrize("stray_deg", [178.0, 40.0])
@pytest.mark.parametrize(
    ("probes", "stray", "are_few"),
    [
        *((100, 0, True), (100, 5, True), (100, 16, True), (100, 17, False)),
        *((20, 3, True), (10, 1, True), (10, 2, False)),
    ],
)
def test_a_few_stray_headings_do_not_widen_all_others(probes, stray, are_few, stray_deg):
    rng = np.random.default_rng(3)
    errors_deg, far = rng.normal(size=probes), np.maximum(1.0, rng.normal(1.0, 0.4, probes))
    errors_deg[:stray] += stray_deg
    constant, growing = fit_heading_variance(errors_deg, far)
    deviation_deg = np.hypot(constant, growing)
    assert 0.5 < deviation_deg < 2.5 if are_few else deviation_deg > 0.3 * stray_deg


def test_headings_that_are_all_exact_have_no_deviation():
    assert fit_heading_variance(np.zeros(12), np.ones(12)) == (0.0, 0.0)


def test_headings_of_which_most_are_exact_have_a_deviation():
    errors_deg = np.append(np.zeros(17), [3.0, -2.0, 4.0])
    assert fit_heading_variance(errors_deg, np.zeros(20))[0] > 0.5
