"""Tilted scans, and scans from which a part of the place is hidden."""

import numpy as np
import pytest

from core.confidence.decision import Refusal
from core.encodings.harmonic.search import HarmonicSearch
from core.encodings.signature import Signature
from core.errors import InvalidParameters, InvalidSignature
from core.evaluation.condition import Condition
from core.localization.localizer import Localizer
from core.mapping.pipeline import build
from core.parameters import MapParameters
from core.projection.imager import ImageKind, Views
from core.scans.drive import MemoryDrive
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor

RECORDED = SimulatedDrive(seed=911, scans=80, sensor=SimulatedSensor(firings=360))
MAPPED, ASKED = range(0, 80, 2), range(1, 80, 4)


@pytest.fixture(scope="module")
def maps():
    drive = MemoryDrive("monday", [RECORDED.scan(i) for i in MAPPED])
    return {
        views: build(
            [drive], MapParameters.for_sensor(views=views), segments=2, calibrated=False
        ).tensor_map
        for views in Views
    }


def right(tensor_map, disturb):
    """Return how many answers are within 4 m of where the query was recorded."""
    localizer, count = Localizer(tensor_map), 0
    for index in ASKED:
        scan = RECORDED.scan(index)
        query = Condition(disturb=disturb).apply(scan, np.random.default_rng(index))
        best = localizer.localize_scan(query).best.pose
        assert best is not None
        assert scan.pose is not None
        count += np.hypot(best.x_m - scan.pose.x_m, best.y_m - scan.pose.y_m) < 4.0
    return count


@pytest.mark.parametrize("disturb", ["hidden:180", "fov:180", "truck:2", "roll:10"])
def test_a_map_of_any_views_answers_them_and_one_of_full_views_often_does_not(maps, disturb):
    assert right(maps[Views.ANY], disturb) >= 0.9 * len(ASKED)
    assert right(maps[Views.ANY], disturb) > right(maps[Views.FULL], disturb)


def test_a_vehicle_may_send_any_ranks_up_to_those_that_the_map_keeps(maps):
    tensor_map = maps[Views.ANY]
    localizer, row = Localizer(tensor_map), 20
    kept = tensor_map.model.recorded[row]
    assert kept.shape == (10, 12)
    for r1, r2 in ((5, 5), (6, 7), (8, 5), (10, 12)):
        signature = Signature(kept[:r1, :r2], None, tensor_map.basis_digest)
        assert localizer.localize_signatures([signature]).best.row == row
    more = np.concatenate([kept, kept[:1]])
    with pytest.raises(InvalidSignature, match=r"\(11, 12\), wanted r1 up to 10 and r2 up to 12"):
        localizer.localize_signatures([Signature(more, None, tensor_map.basis_digest)])


def test_a_scan_of_short_reach_is_found_among_scans_of_longer_reach(maps):
    assert right(maps[Views.ANY], "reach:30") >= 0.9 * len(ASKED)
    assert right(maps[Views.ANY], "reach:30") > right(maps[Views.FULL], "reach:30")


def test_a_scan_of_few_returns_is_refused_in_a_map_of_a_narrow_sensor():
    # A hidden sector of a probe may be all that such a sensor sees: its cells are no measure.
    front = SimulatedDrive(seed=911, scans=60, sensor=SimulatedSensor(firings=360, fov_deg=120.0))
    localizer = Localizer(build([front], MapParameters.for_sensor(), segments=2).tensor_map)
    scan = front.scan(21)
    for returns in (10, 30, 60):
        rows = np.random.default_rng(0).choice(len(scan), returns, replace=False)
        found = localizer.localize_scan(Scan.from_returns(scan.points_m[rows]))
        assert found.decision.reason == Refusal.TOO_FEW_RETURNS
    assert localizer.localize_scan(scan).localized
    half = Condition(disturb="fov:60").apply(scan, np.random.default_rng(0))
    assert localizer.localize_scan(half).decision.reason != Refusal.TOO_FEW_RETURNS


def test_distances_of_a_narrow_view_say_less_than_those_of_a_wide_one(maps):
    tensor_map = maps[Views.ANY]
    basis, scan = tensor_map.basis(), RECORDED.scan(21)
    found = []
    for disturb in ("", "hidden:60", "fov:180", "reach:30", "fov:70"):
        query = Condition(disturb=disturb).apply(scan, np.random.default_rng(0))
        image = basis.image(query)
        [signature] = basis.encode(image)
        found.append(tensor_map.model.search([signature]).evidence)
        assert found[-1] ** 2 == pytest.approx(image.view.share_of(20))
        assert tensor_map.model.search_image(image, basis).evidence == found[-1]
    assert found == sorted(found, reverse=True)
    assert found[0] > 0.95  # it sees nearly all
    assert found[-1] < 0.5


def test_a_narrow_view_is_sent_by_other_ranks_unless_some_are_wanted(maps):
    basis = maps[Views.ANY].basis()
    query = Condition(disturb="fov:70").apply(RECORDED.scan(21), np.random.default_rng(0))
    image = basis.image(query)
    assert basis.encode(image)[0].values.shape == (8, 5)
    for ranks in ((6, 7), (10, 12)):
        assert basis.encode(image, ranks)[0].values.shape == ranks


def test_sensors_at_any_height_share_a_basis_of_any_views(maps):
    basis = maps[Views.ANY].basis()
    higher = MapParameters.for_sensor("os1-64", sensor_height_m=2.5, views=Views.ANY)
    assert basis.serves(higher)
    assert not maps[Views.FULL].basis().serves(MapParameters.for_sensor(sensor_height_m=2.5))
    assert not basis.serves(MapParameters.for_sensor(views=Views.FULL))
    assert basis.serves(MapParameters.for_sensor(ranks=(4, 5), views=Views.ANY))
    assert not basis.serves(MapParameters.for_sensor(ranks=(9, 5), views=Views.ANY))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"encoding": "paper"}, "compares full views only"),
        ({"image": ImageKind.RANGE}, "wants height images"),
        ({"distance": "plain"}, "the normalised distance"),
    ],
)
def test_any_views_of_what_cannot_compare_them_are_rejected(options, message):
    with pytest.raises(InvalidParameters, match=message):
        MapParameters.for_sensor(views=Views.ANY, **options)


@pytest.mark.parametrize("views", list(Views))
def test_an_answer_compares_each_scan_once(maps, views, monkeypatch):
    tensor_map = maps[views]
    localizer, compared = Localizer(tensor_map), []
    [signature] = tensor_map.model.own_queries([20], tensor_map.revision)
    search = localizer.search(signature)
    assert isinstance(search, HarmonicSearch)
    exact = type(search).exact

    def counted(self, rows, *rest):
        if not rest:  # of single renderings it only chooses candidates
            compared.extend(rows.tolist())
        return exact(self, rows, *rest)

    monkeypatch.setattr(type(search), "exact", counted)
    localizer.localize_signatures(signature, k=3)
    assert compared
    assert len(compared) == len(set(compared))


def test_a_sensor_that_sees_little_is_localized_in_a_map_of_its_own_scans():
    little = Condition(disturb="fov:70+reach:30")

    def seen(index):
        return little.apply(RECORDED.scan(index), np.random.default_rng(index))

    drive = MemoryDrive("monday", [seen(index) for index in MAPPED])
    localizer = Localizer(build([drive], MapParameters.for_sensor(views=Views.ANY)).tensor_map)
    calibration = localizer.map.calibration
    assert calibration is not None
    assert calibration.evidence**2 == pytest.approx(70 / 360 * 30 / 80, abs=0.04)
    found = []
    for index in ASKED:
        scan = seen(index)
        for answer in (
            localizer.localize_scan(scan),
            localizer.localize_signatures(localizer.basis.encode(localizer.basis.image(scan))),
        ):
            assert answer.decision.reason != Refusal.TOO_FEW_RETURNS
            if answer.localized:
                assert answer.best.pose is not None
                assert scan.pose is not None
                best, true = answer.best.pose.as_tuple(), scan.pose.as_tuple()
                found.append(np.subtract(best, true)[:2])
    assert len(found) >= len(ASKED) // 2
    assert np.mean(np.linalg.norm(found, axis=1) < 10.0) >= 0.9
