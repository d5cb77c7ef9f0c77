"""From distances to probabilities."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from core.confidence.calibration import MIN_PROBABILITY, Calibration
from core.confidence.logistic import fit_logistic
from core.errors import InvalidMap, InvalidParameters
from core.mapping.tensormap import TensorMap
from storage.files.map_file import read_map, write_map
from tests.support.samples import sample_harmonic_map, sample_map

CALIBRATION = Calibration(
    floor=0.001, both=(-9.0, -3.0, -2.0), alone=(-9.0, -3.5), likelihood=(-8.0, -3.0)
)


def test_a_probability_is_the_logistic_of_the_logarithm_of_the_distance_and_of_the_ratio():
    odds = -9.0 - 3.0 * np.log(0.051) - 2.0 * 0.4
    assert CALIBRATION.probability(0.05, 0.4) == pytest.approx(1 / (1 + np.exp(-odds)))
    odds = -9.0 - 3.5 * np.log(0.051)
    assert CALIBRATION.probability(0.05, None) == pytest.approx(1 / (1 + np.exp(-odds)))


def test_half_the_evidence_is_half_the_logarithm_of_the_odds():
    whole, half = (CALIBRATION.probability(0.05, 0.4, evidence=of_it) for of_it in (1.0, 0.5))
    odds = [np.log(p / (1.0 - p)) for p in (whole, half)]
    assert odds[1] == pytest.approx(0.5 * odds[0])
    assert CALIBRATION.probability(0.05, 0.4, evidence=0.0) == 0.5


def test_the_log_odds_by_signature_count_too_where_both_runners_up_are_known():
    both = replace(CALIBRATION, with_signature=(0.5, 0.75, 0.25))
    odds = 0.5 + 0.75 * (-9.0 - 3.0 * np.log(0.051) - 2.0 * 0.4) + 0.25 * -6.0
    for evidence in (1.0, 0.6):
        found = both.probability(0.05, 0.4, evidence=evidence, odds_of_signature=-6.0)
        assert found == pytest.approx(1 / (1 + np.exp(-evidence * odds)))
    assert both.probability(0.05, 0.4) == CALIBRATION.probability(0.05, 0.4)
    for of, ratio in ((both, None), (CALIBRATION, 0.4)):
        found = of.probability(0.05, ratio, odds_of_signature=-6.0)
        assert found == CALIBRATION.probability(0.05, ratio)


def test_of_a_short_reach_a_signature_counts_if_it_sees_half_of_what_the_probes_see():
    narrow = replace(CALIBRATION, with_signature=(0.5, 0.75, 0.25), evidence=0.4)
    assert narrow.counts_signature(0.4 * 0.71, short_reach=True)
    assert not narrow.counts_signature(0.4 * 0.7, short_reach=True)
    assert narrow.counts_signature(0.4 * 0.1, short_reach=False)
    assert not CALIBRATION.counts_signature(1.0, short_reach=False)


def test_evidence_is_that_of_what_the_map_s_own_scans_see():
    narrow = replace(CALIBRATION, evidence=0.4)
    for of_narrow, of_wide in ((0.4, 1.0), (0.2, 0.5), (0.9, 1.0)):
        assert narrow.probability(0.05, 0.4, evidence=of_narrow) == pytest.approx(
            CALIBRATION.probability(0.05, 0.4, evidence=of_wide)
        )
    assert narrow.probability_of_scan(0.05, 0.4) == CALIBRATION.probability_of_scan(0.05)


def test_lowered_odds_are_lower_with_a_runner_up_without_one_and_within_a_prior():
    lowered = CALIBRATION.lowered(1.5)
    for ratio, share in ((0.4, 1.0), (None, 1.0), (0.4, 0.001), (0.9, 0.3)):
        odds = [
            np.log(p / (1.0 - p))
            for p in (of.probability(0.05, ratio, share) for of in (CALIBRATION, lowered))
        ]
        assert odds[0] - odds[1] == pytest.approx(1.5)
    assert CALIBRATION.lowered(0.0) == CALIBRATION


def test_odds_that_a_signature_has_a_part_in_are_lowered_as_much():
    both = replace(CALIBRATION, with_signature=(0.5, 0.25, 0.25))
    odds = [
        np.log(p / (1.0 - p))
        for p in (of.probability(0.05, 0.4, 1.0, 1.0, -6.0) for of in (both, both.lowered(1.5)))
    ]
    assert odds[0] - odds[1] == pytest.approx(1.5)


def test_with_little_evidence_nothing_is_surer_than_99_percent():
    assert CALIBRATION.probability(0.0, 0.0, evidence=0.5) > 0.99
    assert CALIBRATION.probability(0.0, 0.0, evidence=0.49) == 0.99
    least = CALIBRATION.probability(5.0, 1.0, evidence=0.49)
    assert 0.0 < least < CALIBRATION.probability(5.0, 1.0, evidence=0.4) < 0.5


def test_a_likelihood_ratio_keeps_the_shape_and_rules_out_what_was_not_compared():
    ratios = CALIBRATION.log_likelihood_ratio(np.array([[0.0, 0.05], [0.5, np.inf]]))
    assert ratios.shape == (2, 2)
    assert ratios[0, 1] == pytest.approx(-8.0 - 3.0 * np.log(0.051))
    assert ratios[0, 0] > ratios[0, 1] > ratios[1, 0] > ratios[1, 1] == -np.inf
    blind = replace(CALIBRATION, likelihood=(0.25, 0.0))
    assert blind.log_likelihood_ratio(np.array([0.1, np.inf])).tolist() == [0.25, 0.25]


def test_the_probability_of_one_scan_is_the_logistic_of_its_likelihood_ratio_and_never_certain():
    odds = -8.0 - 3.0 * np.log(0.051)
    assert CALIBRATION.probability_of_scan(0.05) == pytest.approx(1 / (1 + np.exp(-odds)))
    assert CALIBRATION.probability_of_scan(0.05, 0.5) == pytest.approx(1 / (1 + np.exp(-odds / 2)))
    assert CALIBRATION.probability_of_scan(0.0, 0.49) == 0.99
    steep = replace(CALIBRATION, likelihood=(0.0, -900.0))
    assert 0.0 < steep.probability_of_scan(np.inf) < steep.probability_of_scan(0.0) < 1.0


@pytest.mark.parametrize(
    "part",
    [
        {"floor": 0.0},
        {"floor": np.inf},
        {"both": (-9.0, -3.0)},
        {"both": (-9.0, 3.0, -2.0)},
        {"both": (np.nan, -3.0, -2.0)},
        {"alone": (-9.0, 0.5)},
        {"likelihood": (-8.0, 1e-9)},
        {"threshold": -0.1},
        {"threshold": 1.1},
        {"threshold": np.nan},
        {"evidence": 0.0},
        {"evidence": 1.1},
        {"with_signature": (0.0, 1.0, 0.0)},
        {"with_signature": (0.0, -0.1, 1.0)},
        {"with_signature": (np.nan, 1.0, 1.0)},
        {"with_signature": (0.0, 1.0, np.inf)},
        {"with_signature": (0.0, 1.0)},
    ],
)
def test_an_impossible_calibration_is_rejected(part):
    with pytest.raises(InvalidParameters, match=next(iter(part))):
        replace(CALIBRATION, **part)


@pytest.mark.parametrize(("distance", "ratio"), [(-0.1, 0.5), (np.nan, 0.5), (0.1, 1.1), (0.1, -1)])
def test_an_impossible_distance_or_ratio_is_rejected(distance, ratio):
    with pytest.raises(InvalidParameters):
        CALIBRATION.probability(distance, ratio)


def test_a_distance_without_a_slope_says_nothing_also_an_infinite_one():
    flat = Calibration(0.1, (1.0, 0.0, -1.0), (2.0, 0.0), (0.0, 0.0))
    assert flat.log_odds(math.inf, None) == 2.0
    assert flat.log_odds(math.inf, 0.5) == 0.5
    steep = Calibration(0.1, (1.0, -1.0, -1.0), (2.0, -1.0), (0.0, -1.0))
    assert steep.log_odds(math.inf, None) == steep.log_odds(math.inf, 0.5) == -math.inf
    for ratio in (None, 0.5):
        assert 0.0 < flat.probability(math.inf, ratio) < 1.0


def test_attributes_come_back_as_they_were_through_json():
    attributes = json.loads(json.dumps(CALIBRATION.as_attributes()))
    assert Calibration.from_attributes(attributes) == CALIBRATION
    assert CALIBRATION.threshold == MIN_PROBABILITY
    for part in ({"evidence": 0.25}, {"with_signature": (-0.5, 0.75, 0.25)}):
        other = replace(CALIBRATION, **part)
        assert Calibration.from_attributes(json.loads(json.dumps(other.as_attributes()))) == other


def test_a_calibration_of_what_earlier_releases_knew_reads_as_in_their_files():
    assert CALIBRATION.as_attributes().keys().isdisjoint({"evidence", "with_signature"})
    again = Calibration.from_attributes(CALIBRATION.as_attributes())
    assert (again.evidence, again.with_signature) == (1.0, None)


@pytest.mark.parametrize(
    "change",
    [
        {"floor": "none"},
        {"both": 3},
        {"extra": 1},
        {"threshold": 2.0},
        {"alone": [1.0, None]},
        {"with_signature": [0.0, -1.0, 1.0]},
        {"with_signature": []},
    ],
)
def test_invalid_attributes_are_an_invalid_map(change):
    with pytest.raises(InvalidMap, match="calibration"):
        Calibration.from_attributes({**CALIBRATION.as_attributes(), **change})


@pytest.mark.parametrize("made", [sample_map, sample_harmonic_map])
def test_a_calibration_is_in_the_digest_and_comes_back_from_the_file(tmp_path, made):
    tensor_map, _ = made()
    assert tensor_map.calibration is None
    assert "calibration" not in tensor_map.attributes()
    calibrated = replace(tensor_map, calibration=CALIBRATION)
    other = replace(tensor_map, calibration=replace(CALIBRATION, threshold=0.25))
    assert len({m.revision for m in (tensor_map, calibrated, other)}) == 3
    write_map(tmp_path / "map.h5", calibrated)
    again = read_map(tmp_path / "map.h5")
    assert again.calibration == CALIBRATION
    assert again.revision == calibrated.revision


def test_a_map_with_an_incomplete_calibration_is_rejected():
    tensor_map, _ = sample_map()
    torn = {**tensor_map.attributes(), "calibration": {"floor": 0.1}}
    with pytest.raises(InvalidMap, match="calibration"):
        TensorMap.from_parts(tensor_map.arrays(), torn)


def test_classes_that_separate_give_finite_weights_and_sane_probabilities():
    distance = np.log([[0.01], [0.02], [0.03], [0.5], [0.6], [0.7]])
    right = np.array([True] * 3 + [False] * 3)
    weights = fit_logistic(distance, right, np.zeros(1))
    probability = 1 / (1 + np.exp(-(weights[0] + distance[:, 0] * weights[1])))
    assert np.isfinite(weights).all()
    assert (probability[:3] > 0.5).all()
    assert (probability[3:] < 0.5).all()
    assert probability.max() < 0.9  # three samples are not much


def test_a_feature_that_may_only_fall_does_not_rise():
    rising = np.arange(20.0)[:, None]
    right = rising[:, 0] > 9
    assert fit_logistic(rising, right, np.zeros(1))[1] == 0.0
    assert fit_logistic(rising, right, np.array([np.inf]))[1] > 0.0


def test_many_samples_recover_the_weights_they_were_drawn_from():
    rng = np.random.default_rng(0)
    features = rng.normal(size=(20_000, 2)) * (2.0, 0.5) + (1.0, -3.0)
    odds = 0.5 - 1.5 * features[:, 0] - 2.0 * (features[:, 1] + 3.0)
    right = rng.random(20_000) < 1 / (1 + np.exp(-odds))
    found = fit_logistic(features, right, np.zeros(2))
    assert found == pytest.approx([-5.5, -1.5, -2.0], rel=0.05)
    known = -1.5 * features[:, 0]
    rest = fit_logistic(features[:, 1:], right, np.zeros(1), known)
    assert rest == pytest.approx([-5.5, -2.0], rel=0.05)
    nothing = fit_logistic(features, right, np.zeros(2), odds)
    assert nothing == pytest.approx([0.0, 0.0, 0.0], abs=0.1)


@pytest.mark.parametrize(
    ("features", "right", "message"),
    [
        (np.zeros((3, 1)), [True, False], "fit together"),
        (np.full((2, 1), np.inf), [True, False], "finite"),
        (np.zeros((2, 1)), [True, True], "both kinds"),
    ],
)
def test_unusable_samples_are_rejected(features, right, message):
    with pytest.raises(InvalidParameters, match=message):
        fit_logistic(features, np.array(right), np.zeros(1))
