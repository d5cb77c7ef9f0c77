"""Scan queries of maps of any views: their best candidates are compared with small images."""

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from core.confidence.calibration import distance_ratio
from core.confidence.decision import Refusal
from core.confidence.places import away_from
from core.errors import InvalidMap, InvalidParameters
from core.evaluation.condition import Condition
from core.evaluation.disturbances import KITTI_RECORDING
from core.localization.all_maps import AllMapsLocalization, SearchedMap, localize_in_maps
from core.localization.localizer import Localization, Localizer
from core.localization.priors import PositionPrior, Priors
from core.mapping.merge import merge_maps, without_drives
from core.mapping.pipeline import build, build_map
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.projection.imager import Views
from core.projection.small_image import small_image
from core.scans.angles import wrapped_deg
from core.scans.displacement import left_of_m
from core.scans.drive import MemoryDrive
from core.scans.pose import heading_deg
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from core.tracking.track import Observation, Track, Tracker
from tests.support.maps_once import map_once

SENSOR = SimulatedSensor(firings=360)
RECORDED = SimulatedDrive(seed=913, scans=160, sensor=SENSOR)
MAPPED, ASKED = range(0, 160, 2), range(1, 160, 8)
PARAMETERS = MapParameters.for_sensor(views=Views.ANY)


def drive(name, scans):
    return MemoryDrive(name, [RECORDED.scan(i) for i in scans])


@pytest.fixture(scope="module")
def verified(shared):
    def make():
        return build([drive("monday", MAPPED)], PARAMETERS, segments=2).tensor_map

    return map_once(shared, "verified", make)


@pytest.fixture(scope="module")
def signatures_only(verified):
    """The same map without images and their calibration."""
    return TensorMap(
        replace(PARAMETERS, verification_images=False),
        replace(verified.model, verification_images=None),
        verified.trajectory,
        verified.topology,
        verified.relative_error,
        verified.calibration,
    )


def query(index, **condition):
    disturbed = Condition(**condition)
    rng = np.random.default_rng(index)
    pose = disturbed.pose(RECORDED.poses[index])
    return disturbed.apply(RECORDED.scan(index), rng, KITTI_RECORDING), pose


def errors(tensor_map, **condition):
    """Return the position and heading errors of the estimates.

    They need no calibration, which is measured anew for each way to see little.
    """
    localizer = Localizer(replace(tensor_map, calibration=None, image_calibration=None))
    found = []
    for index in ASKED:
        scan, pose = query(index, **condition)
        estimated = localizer.localize_scan(scan).best.estimated_pose
        assert estimated is not None
        turned = wrapped_deg(estimated.yaw_deg - float(heading_deg(pose[None])[0]))
        found.append((np.hypot(estimated.x_m - pose[0], estimated.y_m - pose[1]), abs(turned)))
    return np.array(found).T


def test_maps_of_any_views_have_images_by_default_and_others_cannot():
    assert PARAMETERS.verification_images
    assert not MapParameters.for_sensor(views=Views.FULL).verification_images
    assert not MapParameters.for_sensor(
        views=Views.ANY, verification_images=False
    ).verification_images
    for encoding in ("harmonic", "paper"):
        with pytest.raises(InvalidParameters, match="wants views = any"):
            MapParameters.for_sensor(encoding=encoding, views=Views.FULL, verification_images=True)


def test_the_images_are_of_the_recorded_line_and_counted_apart(verified, signatures_only):
    image = PARAMETERS.imager.image(RECORDED.scan(10))
    np.testing.assert_array_equal(
        verified.model.small_images(np.array([5]))[0], small_image(image.cells)
    )
    assert verified.verification_bytes == 80 * 20 * 60
    assert (verified.elements, signatures_only.verification_bytes) == (signatures_only.elements, 0)
    assert verified.basis_digest == signatures_only.basis_digest


def test_without_a_rendering_on_the_line_places_are_as_exact():
    beside = MapParameters.for_sensor(views=Views.ANY, lateral_renderings_m=(-4.0, -2.0, 2.0, 4.0))
    made = build([drive("monday", MAPPED)], beside, segments=2, calibrated=False).tensor_map
    assert made.model.recorded_lateral_m == -2.0
    for lateral_m in (0.0, 2.0):
        off_m, _ = errors(made, lateral_m=lateral_m)
        assert np.median(off_m) < 0.6


@pytest.mark.parametrize("condition", [{"disturb": "fov:120"}, {"disturb": "truck:2"}])
def test_more_scans_of_which_little_is_seen_are_found(verified, signatures_only, condition):
    by_image, by_signature = (
        (errors(tensor_map, **condition)[0] < 4.0).sum()
        for tensor_map in (verified, signatures_only)
    )
    assert by_image >= 0.95 * len(ASKED)
    assert by_image >= by_signature


@pytest.mark.parametrize(
    "condition", [{}, {"lateral_m": 2.0, "yaw_deg": 90.0}, {"disturb": "hidden:120"}]
)
def test_positions_and_headings_are_those_between_scans(verified, condition):
    metres, degrees = errors(verified, **condition)
    assert np.median(metres) < 0.5
    assert np.median(degrees) < 0.8


def test_without_images_a_scan_is_localized_as_its_signature(signatures_only):
    localizer = Localizer(signatures_only)
    for index in ASKED:
        scan, _ = query(index, disturb="hidden:60")
        by_signature = localizer.localize_signatures(
            localizer.basis.encode(localizer.basis.image(scan)), k=3
        )
        by_scan = localizer.localize_scan(scan, k=3)
        assert by_scan.matches == by_signature.matches


def test_signatures_are_answered_as_without_images(verified, signatures_only):
    one, other = Localizer(verified), Localizer(signatures_only)
    for index in ASKED:
        scan, _ = query(index, disturb="hidden:60")
        signatures = one.basis.encode(one.basis.image(scan))
        ours = [of.localize_signatures(signatures, k=3) for of in (one, other)]
        assert ours[0].matches == ours[1].matches
        assert ours[0].decision == ours[1].decision


def test_scan_queries_have_a_calibration_of_their_own(verified):
    assert verified.image_calibration is not None
    assert verified.image_calibration != verified.calibration
    localizer = Localizer(verified)
    unknown = SimulatedDrive(seed=914, scans=40, sensor=SENSOR)
    inside = [localizer.localize_scan(query(index)[0]) for index in ASKED]
    outside = [localizer.localize_scan(unknown.scan(index)) for index in range(0, 40, 4)]
    assert sum(found.localized for found in inside) >= 0.9 * len(inside)
    assert not any(found.localized for found in outside)
    assert {found.decision.reason for found in outside} <= {
        Refusal.UNKNOWN_PLACE,
        Refusal.AMBIGUOUS,
    }


def probability_of(found: Localization | AllMapsLocalization) -> float:
    assert found.decision.probability is not None
    return found.decision.probability


def with_signature(tensor_map, *weights):
    of_images = replace(tensor_map.image_calibration, with_signature=weights)
    return replace(tensor_map, image_calibration=of_images)


@pytest.mark.parametrize("condition", [{}, {"disturb": "fov:60"}, {"disturb": "reach:20"}])
def test_a_scans_signature_is_searched_as_a_vehicle_sends_it(verified, condition):
    localizer = Localizer(verified)
    for index in ASKED[:5]:
        image = localizer.basis.image(query(index, **condition)[0])
        of_scan = localizer.search_image(image).by_signature
        sent = localizer.search(localizer.basis.encode(image))
        assert of_scan is not None
        assert of_scan.by_signature is sent.by_signature is None
        assert of_scan.limits == sent.limits
        np.testing.assert_allclose(of_scan.distances(), sent.distances(), atol=1e-6)


@pytest.mark.parametrize("condition", [{}, {"disturb": "fov:120"}, {"disturb": "reach:20"}])
def test_a_scans_signature_counts_beside_its_images_unless_it_ends_early(verified, condition):
    without = replace(
        verified, image_calibration=replace(verified.image_calibration, with_signature=None)
    )
    images, both = Localizer(without), Localizer(with_signature(verified, -0.5, 0.75, 0.25))
    for index in ASKED:
        scan, _ = query(index, **condition)
        by_images, found = images.localize_scan(scan), both.localize_scan(scan)
        assert (found.matches, found.ratio) == (by_images.matches, by_images.ratio)
        search = both.search(both.basis.encode(both.basis.image(scan)))
        of_signature = both.map.calibration_of(search)
        of_images = both.map.calibration_of(both.search_image(both.basis.image(scan)))
        assert of_signature is not None
        assert of_images is not None
        row = found.best.row
        distance = search.distances_of(np.array([row]))[0]
        away = search.nearest(1, away_from(verified.trajectory, row)).distances[0]
        odds = None
        if condition != {"disturb": "reach:20"}:
            odds = of_signature.log_odds(distance, distance_ratio(distance, away))
        expected = of_images.probability(
            found.best.distance, found.ratio, 1.0, search.evidence, odds
        )
        assert found.decision.probability == pytest.approx(expected, abs=1e-4)


def test_without_a_calibration_of_signatures_scans_are_answered_by_images_alone(verified):
    [old, lacking] = (
        Localizer(replace(tensor_map, calibration=None))
        for tensor_map in (with_signature(verified, -0.5, 0.75, 0.25), verified)
    )
    without = replace(verified.image_calibration, with_signature=None)
    images = Localizer(replace(verified, image_calibration=without))
    for index in ASKED[:5]:
        scan, _ = query(index)
        decision = images.localize_scan(scan).decision
        assert old.localize_scan(scan).decision == lacking.localize_scan(scan).decision == decision


@pytest.mark.parametrize("slope", [0.1, 5.0])
@pytest.mark.parametrize("intercept", [-4.0, 4.0])
def test_among_maps_a_scan_is_answered_as_by_its_map_or_less_sure(verified, intercept, slope):
    counted = with_signature(verified, intercept, 0.5, slope)
    plain = replace(
        verified, image_calibration=replace(verified.image_calibration, with_signature=None)
    )
    other = build_map(drive("other", range(100, 160, 2)), PARAMETERS, kept=verified.basis())
    for index in (*ASKED[:3], *ASKED[-3:]):
        scan, _ = query(index)
        image = Localizer(verified).basis.image(scan)

        def searched(name, tensor_map, image=image):
            return SearchedMap(name, tensor_map, Localizer(tensor_map).search_image(image))

        alone = Localizer(counted).localize_image(image).decision
        assert localize_in_maps([searched("one", counted)]).decision == alone
        found, by_images = (
            localize_in_maps([searched("one", of), searched("other", other)])
            for of in (counted, plain)
        )
        assert (found.best, found.ratio) == (
            replace(by_images.best, revision=found.best.revision),
            by_images.ratio,
        )
        if found.best.name == "one":
            assert probability_of(found) <= (alone.probability or 0.0)
            if found.runner_up is not None and found.runner_up.name == "other":
                assert probability_of(found) <= probability_of(by_images)


@pytest.fixture(scope="module")
def counting_signatures(verified):
    """The localizer of the map whose scans' signatures count: it measures each narrow view once."""
    return Localizer(with_signature(verified, -1.0, 0.75, 0.5))


@pytest.mark.parametrize("sigma_m", [0.5, 20.0])
def test_a_right_prior_makes_no_scan_less_probable(verified, counting_signatures, sigma_m):
    localizer = counting_signatures
    for index in ASKED:
        scan, pose = query(index, disturb="fov:120")
        prior = Priors(position=PositionPrior(float(pose[0]), float(pose[1]), sigma_m))
        free, within = localizer.localize_scan(scan), localizer.localize_scan(scan, priors=prior)
        matched = verified.trajectory.poses[free.best.row]
        if np.hypot(*(matched - pose)[:2]) < 5.0:
            assert probability_of(within) >= probability_of(free)


def test_a_build_learns_what_signatures_add(verified):
    intercept, of_images, of_signature = verified.image_calibration.with_signature
    assert abs(intercept) < 3.0
    assert 0.2 < of_images < 1.5
    assert 0.0 < of_signature < 1.5
    assert verified.calibration.with_signature is None


def test_an_uncalibrated_map_has_no_probability_of_scans(verified):
    uncalibrated = replace(verified, image_calibration=None)
    scan, _ = query(ASKED[3])
    assert Localizer(uncalibrated).localize_scan(scan).decision.probability is None
    assert uncalibrated.calibration_of_scans is None


def test_scans_have_the_calibration_of_signatures_in_a_map_without_images(
    verified, signatures_only
):
    assert signatures_only.calibration_of_scans == signatures_only.calibration
    assert verified.calibration_of_scans == verified.image_calibration


def test_a_query_of_a_few_rings_is_compared_as_far_as_it_reaches(verified):
    metres, _ = errors(verified, disturb="reach:40")
    assert np.median(metres) < 1.0


def test_merged_maps_have_the_images_of_both_and_selected_ones_their_own():
    first = build_map(drive("monday", range(12)), PARAMETERS)
    second = build_map(drive("tuesday", range(12, 24)), PARAMETERS, kept=first.basis())
    merged = merge_maps([first, second])
    both = np.concatenate([of.model.arrays()["verification_images"] for of in (first, second)])
    np.testing.assert_array_equal(merged.model.arrays()["verification_images"], both)
    left = without_drives(merged, ["monday"])
    np.testing.assert_array_equal(left.model.arrays()["verification_images"], both[len(first) :])
    bare = replace(PARAMETERS, verification_images=False)
    other = build_map(drive("wednesday", range(24, 36)), bare, kept=first.basis())
    with pytest.raises(InvalidParameters, match=r"verification_images is None .*, True in that"):
        merge_maps([first, other])


@pytest.mark.parametrize(
    ("images", "message"),
    [
        (np.zeros((79, 20, 60), np.uint8), r"has shape \(79, 20, 60\), wanted \(80, 20, 60\)"),
        (np.zeros((80, 20, 360), np.uint8), r"wanted \(80, 20, 60\)"),
        (np.zeros((80, 20, 60), np.int64), "holds int64, wanted uint8"),
        (None, "has no verification images"),
    ],
)
def test_images_that_do_not_fit_the_map_are_rejected(verified, images, message):
    with pytest.raises(InvalidMap, match=message):
        replace(verified, model=replace(verified.model, verification_images=images))


@pytest.mark.parametrize("value", [1, "yes", None])
def test_a_parameter_that_is_not_true_or_false_is_rejected(verified, value):
    attributes = {**verified.attributes(), "verification_images": value}
    with pytest.raises(InvalidMap, match="wanted true or false"):
        TensorMap.from_parts(verified.arrays(), attributes)


def test_the_lateral_offset_and_yaw_of_a_tracks_answer_are_those_of_its_pose(verified):
    tracker = Tracker(Localizer(verified))
    track = Track(tracker)
    for index in range(1, 15, 2):
        image = tracker.localizer.basis.image(query(index, lateral_m=0.7)[0])
        signature = tracker.localizer.basis.encode(image)
        with patch("core.mapping.estimate._Around.of", side_effect=AssertionError):  # thrown away
            step = track.observe(Observation(signature, image=image))
        assert step.pose is not None
        row = verified.trajectory.poses[step.row]
        assert step.match.estimated_pose == step.pose
        left_m = left_of_m(row, np.array(step.pose.as_tuple()))
        assert step.match.lateral_m == pytest.approx(left_m, abs=1e-6)
        turned_deg = step.pose.yaw_deg - float(heading_deg(row[None])[0])
        assert step.match.relative_yaw_deg == pytest.approx(wrapped_deg(turned_deg), abs=0.01)
