"""Accepted and refused matches."""

from dataclasses import replace

import numpy as np
import pytest

from core.confidence.calibration import Calibration
from core.confidence.decision import Refusal, decide
from core.errors import InvalidParameters

CALIBRATION = Calibration(
    0.001, (-9.0, -3.0, -2.0), (-9.0, -3.5), (-8.0, -3.0), threshold=0.5, least_cells=100
)


@pytest.mark.parametrize(
    ("distance", "ratio", "cells", "reason"),
    [
        (0.02, 0.3, 500, None),
        (0.02, 0.3, None, None),
        (0.02, 0.3, 100, None),
        (0.02, 0.3, 99, Refusal.TOO_FEW_RETURNS),
        (0.3, 0.3, 99, Refusal.TOO_FEW_RETURNS),
        (0.3, 0.3, 500, Refusal.UNKNOWN_PLACE),
        (0.3, None, 500, Refusal.UNKNOWN_PLACE),
        (0.06, 1.0, 500, Refusal.AMBIGUOUS),
        (0.06, None, 500, None),
    ],
)
def test_a_refusal_has_its_reason(distance, ratio, cells, reason):
    decision = decide(CALIBRATION, distance, ratio, occupied_cells=cells)
    assert decision.reason == reason
    assert decision.localized == (reason is None)
    assert decision.probability == CALIBRATION.probability(distance, ratio)


def test_less_than_a_twelfth_of_what_the_map_s_own_scans_see_is_refused():
    narrow = replace(CALIBRATION, evidence=0.25)
    for calibration, evidence, reason in (
        (CALIBRATION, 0.29, None),
        (CALIBRATION, 0.25, Refusal.TOO_FEW_RETURNS),
        (narrow, 0.25, None),
        (narrow, 0.07, Refusal.TOO_FEW_RETURNS),
    ):
        assert decide(calibration, 0.02, 0.3, evidence=evidence).reason == reason


def test_a_query_can_set_the_minimum_probability():
    assert decide(CALIBRATION, 0.02, 0.3, min_probability=0.999).reason is not None
    assert decide(CALIBRATION, 0.5, 1.0, min_probability=0.0).localized
    with pytest.raises(InvalidParameters, match="min_probability"):
        decide(CALIBRATION, 0.5, 1.0, min_probability=1.5)


def test_without_calibration_only_a_minimum_probability_is_refused():
    assert decide(None, 0.5, 1.0).localized
    assert decide(None, 0.5, 1.0).probability is None
    assert decide(None, 0.5, 1.0, min_probability=0.0).localized
    assert decide(None, 0.1, 0.1, min_probability=0.5).reason == Refusal.NOT_CALIBRATED


def test_a_place_that_is_near_enough_for_its_share_is_ambiguous_and_not_unknown():
    calibration = replace(CALIBRATION, likelihood=(-5.0, -3.0))
    reasons = [decide(calibration, 0.09, 1.0, share=share).reason for share in (1.0, 0.25)]
    assert reasons == [Refusal.UNKNOWN_PLACE, Refusal.AMBIGUOUS]


def test_a_smaller_share_is_more_probable_but_not_more_than_a_single_scan():
    whole = CALIBRATION.probability(0.06, 1.0)
    tenth = CALIBRATION.probability(0.06, 1.0, share=0.1)
    odds = [p / (1 - p) for p in (whole, tenth)]
    assert whole < tenth
    assert odds[1] <= 10 * odds[0] * (1 + 1e-9)
    one = CALIBRATION.probability(0.2, 0.9, share=1e-6)
    alone = float(CALIBRATION.log_likelihood_ratio(np.array(0.2)))
    assert one == pytest.approx(1 / (1 + np.exp(-alone)))
    for share in (0.0, 1.5):
        with pytest.raises(InvalidParameters, match="share"):
            CALIBRATION.probability(0.1, None, share=share)
