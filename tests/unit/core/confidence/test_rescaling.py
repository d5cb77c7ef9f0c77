"""Distances by fewer numbers as distances by the usual ones."""

import numpy as np
import pytest

from core.confidence.calibration import Calibration
from core.confidence.rescaling import Rescaling
from core.confidence.spread import Spread

SPREAD = Spread(0.05, (0.5, 1.0), (0.2, 0.1), (1.0, 0.5))
CALIBRATION = Calibration(
    floor=0.001,
    both=(-9.0, -3.0, -2.0),
    alone=(-9.0, -3.5),
    likelihood=(-8.0, -3.0),
    spread=SPREAD,
)


def test_wrong_places_are_as_near_after_a_rescaling_as_by_the_usual_numbers():
    rng = np.random.default_rng(3)
    usual, fewer = np.exp(rng.normal(-1.2, 0.2, 50)), np.exp(rng.normal(-2.5, 0.5, 50))
    rescaling = Rescaling.of_wrong_places(fewer, usual)
    logarithms = np.log(rescaling.of(fewer))
    assert logarithms.mean() == pytest.approx(np.log(usual).mean())
    assert logarithms.std() == pytest.approx(np.log(usual).std())
    assert rescaling.of(np.array([[np.inf]])).tolist() == [[np.inf]]


def test_fewer_numbers_never_tell_more_than_the_usual_ones():
    usual, fewer = np.array([0.1, 0.2, 0.4]), np.array([0.1, 0.11, 0.12])
    assert Rescaling.of_wrong_places(fewer, usual).power == 1.0


def test_numbers_by_which_all_places_are_equally_near_tell_nothing():
    rescaling = Rescaling.of_wrong_places(np.zeros(5), np.full(5, 0.3))
    np.testing.assert_allclose(rescaling.of(np.array([0.0, 1e-3, 1.0])), 0.3)
    trusted = CALIBRATION.rescaled(rescaling)
    assert trusted.probability(0.0, 0.0) == pytest.approx(trusted.probability(1.0, 0.0))


def test_a_rescaled_calibration_says_of_a_distance_what_it_says_of_the_usual_one():
    rescaling = Rescaling(shift=0.3, power=0.6)
    trusted = CALIBRATION.rescaled(rescaling)
    distances = np.array([0.02, 0.1, 0.5])
    usual = rescaling.of(distances)
    np.testing.assert_allclose(
        trusted.log_likelihood_ratio(distances), CALIBRATION.log_likelihood_ratio(usual), atol=0.15
    )
    for fewer, as_usual in zip(distances.tolist(), usual.tolist(), strict=True):
        for ratio in (None, 0.5):
            assert trusted.probability(fewer, ratio) == pytest.approx(
                CALIBRATION.probability(as_usual, ratio), abs=0.02
            )
    assert trusted.probability(0.0, None) == pytest.approx(CALIBRATION.probability(0.0, None))


def test_a_typical_distance_of_right_answers_is_rescaled_too():
    rescaling = Rescaling(shift=0.3, power=0.6)
    spread = SPREAD.rescaled(rescaling)
    assert CALIBRATION.rescaled(rescaling).spread == spread
    assert rescaling.of(np.array(spread.typical)) == pytest.approx(SPREAD.typical)
    assert (spread.along_m, spread.lateral_m) == (SPREAD.along_m, SPREAD.lateral_m)
