"""Queries that have or see less than a map's own: found less often, no less honest."""

from dataclasses import replace

import numpy as np
import pytest

from core.confidence.decision import Refusal
from core.errors import InvalidParameters, InvalidSignature
from core.evaluation.condition import Condition
from core.localization.localizer import Localizer
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.projection.imager import Image, Views
from core.projection.visibility import FULL_VIEW, SECTORS, View, hide
from core.scans.angles import wrapped_deg
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from tests.support.maps_once import map_once

SCANS = 120
SENSOR = SimulatedSensor(firings=720)  # two in each column of an image


@pytest.fixture(scope="module")
def localizer(shared):
    drive = SimulatedDrive(seed=8101, scans=SCANS, sensor=SENSOR)
    parameters = MapParameters.for_sensor(views=Views.ANY)
    return Localizer(map_once(shared, "limited-queries", lambda: build_map(drive, parameters)))


def asked(**drive):
    """Return every fourth scan of a drive: each is disturbed many times."""
    simulated = SimulatedDrive(scans=SCANS, sensor=SENSOR, **drive)
    return [simulated.scan(index) for index in range(0, SCANS, 4)]


@pytest.fixture(scope="module")
def second():
    """Scans of a second pass through the city."""
    return asked(seed=8101, traffic_seed=9, lateral_offset_m=1.0)


@pytest.fixture(scope="module")
def other():
    """Scans of a drive through another city."""
    return asked(seed=8102)


@pytest.fixture(scope="module")
def known(localizer, second):
    """Images of a second pass."""
    return [localizer.basis.image(scan) for scan in second]


@pytest.fixture(scope="module")
def unknown(localizer, other):
    """Images of another city."""
    return [localizer.basis.image(scan) for scan in other]


def is_near(found, scan):
    """Return whether a query was localized within 10 m of where its scan was recorded."""
    matched = found.best.pose
    return np.hypot(matched.x_m - scan.pose.x_m, matched.y_m - scan.pose.y_m) < 10.0


def localized(localizer, image, ranks):
    return localizer.localize_signatures(localizer.basis.encode(image, ranks))


@pytest.mark.parametrize(
    ("ranks", "most_elsewhere", "least_found"),
    [((5, 5), 0.03, 0.85), ((4, 4), 0.04, 0.7), ((3, 3), 0.1, 0.55)],
)
def test_few_numbers_find_no_place_in_another_city_and_no_wrong_one_in_their_own(
    localizer, second, known, unknown, ranks, most_elsewhere, least_found
):
    assert localizer.map.calibration is not None
    elsewhere = sum(localized(localizer, image, ranks).localized for image in unknown)
    assert elsewhere <= most_elsewhere * len(unknown)
    found = [localized(localizer, image, ranks) for image in known]
    right = [is_near(of, scan) for of, scan in zip(found, second, strict=True) if of.localized]
    assert all(right)
    assert len(right) >= least_found * len(known)


def test_signatures_that_cannot_tell_places_apart_are_refused_with_the_ranks_that_are_wanted(
    localizer, known
):
    [whole] = localizer.basis.encode(known[0])
    for r1, r2 in ((2, 2), (2, 7), (6, 2), (1, 1)):
        sent = f"has {r1} x {r2} numbers, .* wanted 6 x 7, or at least 3 x 3$"
        with pytest.raises(InvalidSignature, match=sent):
            localizer.localize_signatures([replace(whole, values=whole.values[:r1, :r2])])
        with pytest.raises(InvalidParameters, match=f"ranks are {r1} x {r2}"):
            localizer.basis.encode(known[0], (r1, r2))


def test_all_numbers_that_a_map_keeps_count_as_its_own_queries_do(localizer, known):
    image = known[3]
    for ranks in ((6, 7), (10, 12)):
        search = localizer.search(localizer.basis.encode(image, ranks))
        assert localizer.map.calibration_of(search) is localizer.map.calibration
    fewer = localizer.search(localizer.basis.encode(image, (5, 5)))
    assert localizer.map.calibration_of(fewer) != localizer.map.calibration
    assert localizer.map.rescaling_of(fewer) is localizer.map.rescaling_of(fewer)


def images_under(localizer, scans, disturbance):
    condition, rng = Condition(disturb=disturbance), np.random.default_rng(5)
    return [localizer.basis.image(condition.apply(scan, rng)) for scan in scans]


@pytest.mark.parametrize(
    ("disturbance", "most_elsewhere"),
    [("reach:12", 0.2), ("reach:20", 0.2), ("fov:60", 0.1), ("hidden:270", 0.1)],
)
def test_a_view_of_little_finds_hardly_a_place_in_another_city(
    localizer, other, disturbance, most_elsewhere
):
    found = [
        localized(localizer, image, None).localized
        for image in images_under(localizer, other, disturbance)
    ]
    assert sum(found) <= most_elsewhere * len(found)


@pytest.mark.parametrize("disturbance", ["fov:180+reach:30", "fov:120+reach:30", "fov:90+reach:30"])
def test_a_view_that_is_narrow_and_short_finds_hardly_a_place_in_another_city(
    localizer, other, disturbance
):
    found = [
        localized(localizer, image, None).localized
        for image in images_under(localizer, other, disturbance)
    ]
    assert sum(found) <= 0.15 * len(found)


@pytest.mark.parametrize("disturbance", ["fov:120+reach:20", "fov:60+reach:20"])
def test_a_view_of_less_than_a_twelfth_is_refused_for_what_it_lacks(localizer, second, disturbance):
    for image in images_under(localizer, second[::6], disturbance):
        assert image.view.share_of(20) < 0.08
        for found in (localized(localizer, image, None), localizer.localize_image(image)):
            assert found.decision.reason == Refusal.TOO_FEW_RETURNS


@pytest.mark.parametrize(
    ("disturbance", "least_found"), [("fov:120", 0.5), ("fov:90", 0.4), ("hidden:180", 0.5)]
)
def test_a_view_of_a_part_finds_its_place_in_its_own_city_and_no_wrong_one(
    localizer, second, disturbance, least_found
):
    images = images_under(localizer, second, disturbance)
    found = [localized(localizer, image, None) for image in images]
    right = [is_near(of, scan) for of, scan in zip(found, second, strict=True) if of.localized]
    assert all(right)
    assert len(right) >= least_found * len(second)


def test_views_are_measured_in_few_classes(localizer):
    limits_of, ranks = localizer.map.model.limits_of, (8, 7)
    assert limits_of(ranks, FULL_VIEW) is None
    assert limits_of(ranks, View(tuple(range(40)))) is None  # a third of the view is left
    assert limits_of(ranks, View((), 7)) is None
    narrow = limits_of(ranks, View(tuple(range(7, 55))))
    assert narrow == limits_of(ranks, View(tuple(range(50))))
    assert narrow != limits_of(ranks, View(tuple(range(50)), 4)) != limits_of(ranks, View((), 4))
    assert limits_of(ranks, View(tuple(range(15)), 10)) is None
    both = limits_of(ranks, View(tuple(range(30)), 10))  # a quarter of the cells is left
    assert both == limits_of(ranks, View(tuple(range(7, 36)), 9)) != limits_of(ranks, View((), 5))
    classes = {
        limits_of(ranks, View(tuple(range(hidden)), rings))
        for hidden in range(60)
        for rings in (None, *range(3, 12))
    }
    assert len(classes) <= 32


def test_scans_of_a_narrow_and_short_view_find_hardly_a_place_in_another_city(localizer, other):
    images = images_under(localizer, other, "fov:180+reach:20")
    found = [localizer.localize_image(image).localized for image in images]
    assert sum(found) <= 0.04 * len(found)


def test_scans_of_a_short_reach_that_see_all_around_count_as_the_map_is_calibrated(localizer):
    tensor_map = localizer.map
    cells = np.zeros((20, 360), np.float32)
    cells[:6] = 1.0
    short = localizer.search_image(Image(cells, tensor_map.parameters.grid))
    assert tensor_map.calibration_of(short) is tensor_map.image_calibration
    narrow = Image(hide(cells, np.arange(SECTORS) < 30), tensor_map.parameters.grid)
    both = tensor_map.calibration_of(localizer.search_image(narrow))
    assert both.both[0] < tensor_map.image_calibration.both[0]


def test_scans_of_little_of_a_view_find_hardly_a_place_in_another_city(localizer, other):
    views = ("fov:90", "fov:60", "hidden:270", "hidden:300")
    found = [
        localizer.localize_image(image).localized
        for view in views
        for image in images_under(localizer, other, view)
    ]
    assert sum(found) <= 0.02 * len(found)


@pytest.mark.parametrize(
    ("disturbance", "least_found"),
    [("", 1.0), ("fov:180", 0.95), ("fov:120", 0.8), ("hidden:240", 0.7), ("fov:90", 0.4)],
)
def test_scans_of_a_part_of_a_view_find_their_place_and_no_wrong_one(
    localizer, second, disturbance, least_found
):
    images = images_under(localizer, second, disturbance)
    found = [localizer.localize_image(image) for image in images]
    right = [is_near(of, scan) for of, scan in zip(found, second, strict=True) if of.localized]
    assert all(right)
    assert len(right) >= least_found * len(second)


def test_scans_that_see_more_than_a_third_count_as_the_map_is_calibrated(localizer, known):
    image = known[3]
    tensor_map = localizer.map

    def calibration(hidden):
        cells = hide(image.cells, np.arange(SECTORS) >= hidden)
        return tensor_map.calibration_of(localizer.search_image(replace(image, cells=cells)))

    whole = tensor_map.image_calibration
    assert calibration(0) is calibration(30) is whole
    third, quarter, sixth = calibration(40), calibration(45), calibration(50)
    assert whole.both[0] > third.both[0] > quarter.both[0] > sixth.both[0]
    assert quarter == calibration(46)
    assert [quarter.both[1:], quarter.floor] == [whole.both[1:], whole.floor]


@pytest.mark.parametrize("disturb", ["fov:120", "fov:90"])
def test_deviations_of_a_narrow_view_cover_its_errors(localizer, second, disturb):
    within = []
    for number, scan in enumerate(second):
        query = Condition(disturb=disturb).apply(scan, np.random.default_rng(number))
        found = localizer.localize_scan(query, min_probability=0.0)
        if is_near(found, scan):
            best, deviation = found.best, found.deviation
            heading_deg = abs(wrapped_deg(best.heading_deg - scan.pose.yaw_deg))
            off_m = np.array([best.estimated_pose.x_m - scan.pose.x_m])
            off_m = np.append(off_m, best.estimated_pose.y_m - scan.pose.y_m)
            xx, xy, yy = found.position_covariance_m2
            squares = off_m @ np.linalg.inv([[xx, xy], [xy, yy]]) @ off_m
            # Of a normal distribution 0.95 and 0.95 are.
            within.append((heading_deg <= 2.0 * deviation.heading_deg, squares <= 6.0))
    assert len(within) >= 20
    assert (np.mean(within, axis=0) >= 0.85).all()
