"""A map learns from its own scans."""

from dataclasses import replace

import numpy as np
import pytest

from core.confidence.calibration import MIN_PROBABILITY
from core.confidence.spread import Deviation, Spread, fit_variance
from core.encodings.paper.encoding import PaperEncoding
from core.errors import InvalidMap, InvalidParameters
from core.localization.candidates import find_candidates
from core.localization.localizer import Localizer
from core.mapping.calibrate import calibrate
from core.mapping.fit import fit_map
from core.parameters import MapParameters
from core.projection.images import MemoryImages
from core.scans.trajectory import Trajectory
from tests.support.samples import (
    SMALL_GRID,
    RecordedProgress,
    calibrated_map,
    noisy_probes,
    sample_image,
    sample_map,
    smooth_images,
    straight_poses,
)


@pytest.fixture(scope="module")
def made():
    return calibrated_map()


def test_a_map_is_calibrated_when_it_is_built_and_the_same_every_time(made):
    assert made.calibration is not None
    assert calibrated_map().revision == made.revision
    assert calibrate(made, noisy_probes(smooth_images(120, SMALL_GRID.shape))) == made.calibration


@pytest.mark.parametrize("posed", [True, False])
def test_a_second_pass_without_poses_makes_no_right_match_a_wrong_one(posed):
    images = smooth_images(120, SMALL_GRID.shape)
    noise = np.random.default_rng(9).normal(scale=0.3, size=images.shape)
    both = np.concatenate([images, np.maximum(images + noise, 0.1)]).astype(np.float32)
    unknown = np.full((120, 7), np.nan)
    drives = [
        Trajectory.of_drive(name, np.full(120, np.nan), poses, np.arange(120))
        for name, poses in (
            ("first", straight_poses(120) if posed else unknown),
            ("second", unknown),
        )
    ]
    twice = fit_map(
        MemoryImages(both, SMALL_GRID),
        Trajectory.concatenate(drives),
        np.array([0, 60, 120, 180, 240]),
        MapParameters(grid=SMALL_GRID, ranks=(3, 4), sensor="hdl-64e"),
        probes=noisy_probes(both),
    )
    rng = np.random.default_rng(5)
    found = [
        Localizer(twice).localize_image(sample_image(twice, np.maximum(image, 0.1)))
        for image in images[1::2] + rng.normal(scale=0.5, size=(60, 6, 19))
    ]
    assert np.median([one.decision.probability or 0.0 for one in found]) > 0.9


def test_calibrating_reports_its_progress():
    progress = RecordedProgress()
    images = smooth_images(40, SMALL_GRID.shape)
    tensor_map = calibrated_map(40)
    calibrate(tensor_map, noisy_probes(images), progress)
    assert progress.stages == [("calibrating", 20)]
    assert progress.done == [20]


def test_a_place_of_the_map_is_probable_and_one_of_elsewhere_is_not(made):
    localizer = Localizer(made)
    rng = np.random.default_rng(5)
    known = smooth_images(120, SMALL_GRID.shape)[1::2] + rng.normal(scale=0.5, size=(60, 6, 19))
    unknown = smooth_images(120, SMALL_GRID.shape, seed=77)[1::2]
    of_known, of_unknown = (
        [localizer.localize_image(sample_image(made, np.maximum(image, 0.1))) for image in images]
        for images in (known, unknown)
    )
    assert np.mean([found.localized for found in of_known]) > 0.9
    assert np.mean([found.localized for found in of_unknown]) < 0.1
    assert {found.decision.reason for found in of_unknown} & {"unknown_place", "ambiguous"}
    probable = [found.decision.probability for found in of_known]
    assert np.median(np.array(probable, dtype=np.float64)) > 0.9


def test_sharper_odds_change_probabilities_and_no_decision(made, monkeypatch):
    monkeypatch.setattr(PaperEncoding, "sharper", 2.0)
    sharp = calibrate(made, noisy_probes(smooth_images(120, SMALL_GRID.shape)))
    assert sharp is not None
    assert sharp.both == tuple(2.0 * weight for weight in made.calibration.both)
    assert (sharp.likelihood, sharp.floor) == (made.calibration.likelihood, made.calibration.floor)
    for distance, ratio in np.random.default_rng(3).uniform(0.0, 1.0, (200, 2)):
        before, after = (known.probability(distance, ratio) for known in (made.calibration, sharp))
        assert (before >= MIN_PROBABILITY) == (after >= MIN_PROBABILITY)
        assert abs(after - 0.5) >= abs(before - 0.5)


def test_a_standard_deviation_is_returned_where_poses_are_known(made):
    found = Localizer(made).localize_image(
        sample_image(made, smooth_images(120, SMALL_GRID.shape)[51])
    )
    assert found.deviation is not None
    assert 0.2 < found.deviation.along_m < 5.0
    covariance = found.position_covariance_m2
    assert covariance is not None  # the path is along x
    assert covariance[0] == pytest.approx(found.deviation.along_m**2)
    assert covariance[1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("opposed", "least_deg", "most_deg"), [(6, 1.5, 2.5), (12, 50.0, 90.0)])
def test_a_few_probes_in_the_opposite_direction_widen_no_heading(
    made, opposed, least_deg, most_deg
):
    probes = noisy_probes(smooth_images(120, SMALL_GRID.shape))
    displacement = np.zeros_like(probes.displacement)
    displacement[:, 2] = np.where(np.arange(len(displacement)) % 2, 2.0, -2.0)
    displacement[:opposed, 2] = 178.0
    found = calibrate(made, replace(probes, displacement=displacement))
    assert found is not None
    spread = found.spread
    assert spread is not None
    assert least_deg < np.hypot(*spread.heading_deg) < most_deg


def test_without_poses_scans_count_and_no_metres_are_claimed():
    tensor_map = calibrated_map(160, poses=False)
    assert tensor_map.calibration is not None
    assert tensor_map.calibration.spread is None
    image = smooth_images(160, SMALL_GRID.shape)[51]
    found = Localizer(tensor_map).localize_image(sample_image(tensor_map, image))
    assert found.localized
    assert found.deviation is None
    assert found.position_covariance_m2 is None


def test_a_map_of_one_neighbourhood_is_not_calibrated():
    assert calibrated_map(20).calibration is None


def test_a_map_whose_neighbours_are_unlike_is_not_calibrated():
    tensor_map, images = sample_map(count=60, segment_length=30)
    assert calibrate(tensor_map, noisy_probes(images)) is None


def test_a_map_built_without_probes_is_as_it_was():
    made = calibrated_map(40)
    images = MemoryImages(smooth_images(40, SMALL_GRID.shape), SMALL_GRID)
    plain = fit_map(images, made.trajectory, made.model.segment_start, made.parameters)
    assert plain.calibration is None
    assert replace(made, calibration=None).revision == plain.revision
    found = Localizer(plain).localize_image(sample_image(plain, images.read(7, 8)[0]))
    assert found.localized
    assert found.decision.probability is None


def test_the_share_searched_is_that_of_the_segments_that_signatures_came_for(made):
    basis = made.basis()
    image = sample_image(made, smooth_images(120, SMALL_GRID.shape)[3])
    signatures = basis.encode(image)
    whole = find_candidates(made, made.model.search(signatures), 1)
    half = find_candidates(made, made.model.search(signatures[:1]), 1)
    assert (whole.share, half.share) == (1.0, 0.5)


def test_errors_of_one_size_have_a_constant_variance():
    a, b = fit_variance(np.array([1.0, -1.0] * 50), np.linspace(0.0, 3.0, 100))
    assert a == pytest.approx(1.0, rel=1e-2)
    assert b == pytest.approx(0.0, abs=0.05)
    assert fit_variance(np.zeros(5), np.ones(5)) == (0.0, 0.0)


SPREAD = Spread(0.1, (1.0, 2.0), (0.5, 0.25), (1.0, 0.0))


def test_a_deviation_grows_with_distance_and_spread_and_never_falls_below_a_typical_one():
    assert SPREAD.deviation(0.2, 3.0).along_m == pytest.approx(np.hypot(1.0, 6.0))
    assert SPREAD.deviation(0.2, 3.0).lateral_m == pytest.approx(np.hypot(0.5, 0.5))
    assert SPREAD.deviation(0.0, 0.0) == SPREAD.deviation(0.1, 0.0)
    assert SPREAD.deviation(0.5, 0.0).heading_deg == 1.0


def test_a_covariance_has_the_deviations_as_its_axes():
    xx, xy, yy = Deviation(3.0, 1.0, 1.0).covariance_m2(30.0)
    values, vectors = np.linalg.eigh([[xx, xy], [xy, yy]])
    assert values == pytest.approx([1.0, 9.0])
    assert np.abs(vectors[:, 1]) == pytest.approx([np.cos(np.pi / 6), np.sin(np.pi / 6)])


@pytest.mark.parametrize(
    "part", [{"typical": 0.0}, {"along_m": (1.0,)}, {"lateral_m": (-1.0, 0.0)}]
)
def test_an_invalid_spread_is_rejected(part):
    with pytest.raises(InvalidParameters, match=next(iter(part))):
        replace(SPREAD, **part)


def test_a_spread_comes_back_from_its_attributes_whole_or_not_at_all(made):
    assert Spread.from_attributes(SPREAD.as_attributes()) == SPREAD
    assert made.from_parts(made.arrays(), made.attributes()).calibration == made.calibration
    with pytest.raises(InvalidMap, match="spread"):
        Spread.from_attributes({"typical": 1.0})
