"""Calibration errors and refusals, against values computed by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.errors import InvalidParameters
from core.evaluation.reliability import (
    Outcome,
    expected_calibration_error,
    reliability,
)


def test_the_calibration_error_is_the_mean_gap_of_the_bins():
    # Bin 9: two of mean 0.95, half right: 0.45. Bin 0: two of mean 0.05, none right: 0.05.
    probability = np.array([0.95, 0.95, 0.02, 0.08])
    right = np.array([True, False, False, False])
    assert expected_calibration_error(probability, right) == pytest.approx(0.25)
    assert expected_calibration_error(np.array([1.0]), np.array([True])) == 0.0


def test_adaptive_bins_hold_as_many_samples_each():
    # 20 samples: pairs. In bins as wide, all in one: its mean gap is 0.
    probability = np.linspace(0.50, 0.59, 20)
    right = np.arange(20) % 2 == 0
    wide = expected_calibration_error(probability, right)
    assert wide == pytest.approx(abs(probability.mean() - 0.5))
    right = np.arange(20) < 10
    pairs = probability.reshape(10, 2).mean(axis=1)
    expected = np.abs(pairs - right[::2]).mean()
    assert expected_calibration_error(probability, right, adaptive=True) == pytest.approx(expected)


def test_equal_probabilities_are_of_one_adaptive_bin():
    probability, right = np.full(100, 0.5), np.arange(100) < 50
    assert expected_calibration_error(probability, right, adaptive=True) == 0.0


@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.booleans())
def test_the_order_of_samples_does_not_change_a_calibration_error(seed, count, adaptive):
    rng = np.random.default_rng(seed)
    samples = np.stack([rng.integers(0, 6, count) / 5, rng.random(count) < 0.5, rng.random(count)])
    one, other = (
        expected_calibration_error(p, right > 0, adaptive=adaptive, weight=weight)
        for p, right, weight in (samples, samples[:, rng.permutation(count)])
    )
    assert one == pytest.approx(other, abs=1e-12)


@given(st.integers(0, 2**32 - 1), st.integers(1, 99))
def test_adaptive_bins_of_unequal_probabilities_are_tenths_of_them(seed, count):
    rng = np.random.default_rng(seed)
    probability, right = rng.permutation(np.arange(count) / count), rng.random(count) < 0.5
    tenth = np.empty(count, np.int64)
    tenth[np.argsort(probability)] = np.arange(count) * 10 // count
    gaps = [abs((probability - right)[tenth == i].sum()) for i in range(10)]
    found = expected_calibration_error(probability, right, adaptive=True)
    assert found == pytest.approx(sum(gaps) / count, abs=1e-12)


def test_weights_count_samples_more_or_less():
    probability, right = np.array([0.95, 0.05]), np.array([False, False])
    weighted = expected_calibration_error(probability, right, weight=np.array([1.0, 3.0]))
    assert weighted == pytest.approx((0.95 + 3 * 0.05) / 4)


@pytest.mark.parametrize("probability", [[], [1.5], [-0.1], [np.nan]])
def test_numbers_that_are_no_probability_are_rejected(probability):
    with pytest.raises(InvalidParameters, match="probability"):
        expected_calibration_error(np.array(probability), np.ones(len(probability), bool))


def test_refusals_are_counted_among_right_wrong_and_unknown():
    known = [
        Outcome(0.9, localized=True, right=True),
        Outcome(0.3, localized=False, right=True),
        Outcome(0.2, localized=False, right=False),
    ]
    unknown = [
        Outcome(0.6, localized=True, right=False),
        Outcome(0.1, localized=False, right=False),
    ]
    found = reliability(known, unknown)
    assert (found.refused_right, found.refused_wrong, found.refused_unknown) == (0.5, 1.0, 0.5)
    assert found.unknown_queries == 2
    assert found.auroc == pytest.approx(4 / 6)
    # Scores fall as known, unknown, known, known, unknown.
    assert found.average_precision == pytest.approx((1 + 2 / 3 + 3 / 4) / 3)
    # Each known counts 1/6, each unknown 1/4; every one has a bin of its own.
    gaps = (0.1 + 0.7 + 0.2) / 6 + (0.6 + 0.1) / 4
    assert found.ece_mixed == pytest.approx(gaps)


def test_without_unknown_places_only_the_known_are_counted():
    found = reliability([Outcome(0.9, localized=True, right=True)], [])
    assert found.auroc is None
    assert found.ece_mixed is None
    assert found.refused_wrong is None
    assert found.ece == pytest.approx(0.1)
