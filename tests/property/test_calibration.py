"""Laws of every calibration, and of the distances that it takes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.confidence.calibration import Calibration
from core.confidence.logistic import fit_logistic
from core.localization.localizer import Localizer
from core.projection.imager import Image
from tests.support.samples import sample_harmonic_map, sample_map

intercepts = st.floats(-50.0, 50.0)
slopes = st.floats(-20.0, 0.0)
distances = st.floats(0.0, 1e6)
ratios = st.none() | st.floats(0.0, 1.0)
calibrations = st.builds(
    Calibration,
    floor=st.floats(1e-9, 10.0),
    both=st.tuples(intercepts, slopes, slopes),
    alone=st.tuples(intercepts, slopes),
    likelihood=st.tuples(intercepts, slopes),
    threshold=st.floats(0.0, 1.0),
    with_signature=st.none() | st.tuples(intercepts, st.floats(0.0, 20.0), st.floats(1e-9, 20.0)),
)


@given(calibrations, distances, ratios)
def test_a_probability_is_above_0_and_below_1(calibration, distance, ratio):
    assert 0.0 < calibration.probability(distance, ratio) < 1.0


@given(calibrations, distances, distances, ratios)
def test_a_greater_distance_is_never_more_probable(calibration, one, two, ratio):
    near, far = sorted((one, two))
    # The least ratio that counts falls with the distance: compared where it does not bind.
    if ratio is not None:
        ratio = max(ratio, calibration.floor / (near + calibration.floor))
    assert calibration.probability(near, ratio) >= calibration.probability(far, ratio)


@given(calibrations, distances, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_ratio_nearer_1_is_never_more_probable(calibration, distance, one, two):
    low, high = sorted((one, two))
    assert calibration.probability(distance, low) >= calibration.probability(distance, high)


@given(calibrations, distances, ratios, st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_a_match_that_its_signature_confirms_more_is_never_less_probable(
    calibration, distance, ratio, one, two
):
    low, high = (
        calibration.probability(distance, ratio, odds_of_signature=odds)
        for odds in sorted((one, two))
    )
    assert 0.0 < low <= high < 1.0


@given(calibrations, st.lists(distances, min_size=2, max_size=8))
def test_the_likelihood_ratio_falls_with_the_distance(calibration, many):
    ratio = calibration.log_likelihood_ratio(np.sort(many))
    assert (np.diff(ratio) <= 1e-9 * np.abs(ratio[1:]) + 1e-12).all()


@given(calibrations)
def test_attributes_come_back_as_they_were(calibration):
    assert Calibration.from_attributes(calibration.as_attributes()) == calibration


@given(st.integers(0, 2**32 - 1), st.integers(2, 40), st.floats(0.0, 5.0))
def test_weights_are_finite_and_the_mean_probability_is_near_the_share_right(seed, n, apart):
    rng = np.random.default_rng(seed)
    right = np.arange(n) < max(1, n // 2)
    features = rng.normal(size=(n, 2)) - apart * right[:, None]
    weights = fit_logistic(features, right, np.zeros(2))
    assert np.isfinite(weights).all()
    probability = 1 / (1 + np.exp(-(weights[0] + features @ weights[1:])))
    # The intercept has no ridge: the mean is that of the targets.
    targets = np.where(right, (right.sum() + 1) / (right.sum() + 2), 1 / ((~right).sum() + 2))
    assert probability.mean() == pytest.approx(targets.mean(), abs=1e-3)


@pytest.fixture(scope="module", params=[sample_map, sample_harmonic_map])
def made(request):
    return request.param(count=24, segment_length=8)


@given(st.integers(0, 23), st.integers(0, 2**24 - 1))
def test_distances_are_those_of_the_nearest_and_infinite_where_not_compared(made, row, mask):
    tensor_map, images = made
    image = images[row] if images.ndim == 3 else images[row, 1]
    localizer = Localizer(tensor_map)
    signatures = localizer.basis.encode(Image(image, tensor_map.parameters.grid))
    search = tensor_map.model.search(signatures)
    among = np.array([mask >> i & 1 for i in range(24)], dtype=bool)
    found = search.distances(among)
    assert np.isinf(found[~among]).all()
    nearest = search.nearest(24, among)
    by_row = dict(zip(nearest.rows.tolist(), nearest.distances.tolist(), strict=True))
    assert {i: found[i] for i in np.flatnonzero(among).tolist()} == by_row
    assert (search.distances()[among] == found[among]).all()


def test_segments_without_a_signature_have_no_distance(made):
    tensor_map, images = made
    if images.ndim != 3:
        pytest.skip("a harmonic map is always searched whole")
    localizer = Localizer(tensor_map)
    signatures = localizer.basis.encode(Image(images[3], tensor_map.parameters.grid))
    found = tensor_map.model.search(signatures[1:2]).distances()
    assert np.isfinite(found).tolist() == [8 <= i < 16 for i in range(24)]
