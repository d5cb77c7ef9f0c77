"""The likelihood of distances: between a map's own scans, and of what a belief needs."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from core.arrays import FloatArray
from core.confidence.calibration import Calibration
from core.encodings.harmonic.masked_search import MaskedSearch
from core.encodings.search import Neighbours, Search
from core.evaluation.condition import Condition
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.scans.drive import MemoryDrive
from core.scans.trajectory import Trajectory
from core.tracking import emission as emission_module
from core.tracking.emission import Emission, OwnDistances, _half_way
from tests.support.recording import recording
from tests.support.samples import calibrated_map, own_signatures, sample_harmonic_map


def test_without_poses_all_scans_of_other_drives_are_elsewhere():
    tensor_map, _ = sample_harmonic_map(count=16, drives=2, poses=False)
    drive = tensor_map.trajectory.drive_of_scan
    nearest = [
        tensor_map.model.search(own_signatures(tensor_map, row)).distances()[drive != drive[row]]
        for row in range(len(tensor_map))
    ]
    expected = np.quantile([distances.min() for distances in nearest], 0.1)
    assert OwnDistances.of_map(tensor_map).decision_distance == pytest.approx(expected)


def test_the_decision_distance_is_half_way_between_scans_beside_and_scans_50_m_away():
    tensor_map = calibrated_map(32)  # a metre between scans on a line, drawn out to four
    poses = tensor_map.trajectory.poses * [4.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    tensor_map = replace(tensor_map, trajectory=replace(tensor_map.trajectory, poses=poses))
    elsewhere, beside = [], []
    for row in range(len(tensor_map)):
        distances = tensor_map.model.search(own_signatures(tensor_map, row)).distances()
        apart_m = 4.0 * np.abs(np.arange(len(tensor_map)) - row)
        elsewhere.append(distances[apart_m >= 50.0].min(initial=np.inf))
        beside.append(distances[(apart_m > 0.0) & (apart_m < 10.0)].min())
    near, far = np.quantile(beside, 0.9), np.quantile(elsewhere, 0.1)
    assert near < far
    assert OwnDistances.of_map(tensor_map).decision_distance == pytest.approx(np.sqrt(near * far))


def test_a_place_where_the_vehicle_stood_counts_once_for_what_is_near():
    tensor_map = calibrated_map(64)
    poses = tensor_map.trajectory.poses.copy()
    poses[8:48, :3] = poses[8, :3]
    stood = replace(tensor_map, trajectory=replace(tensor_map.trajectory, poses=poses))
    own = OwnDistances.of_map(stood)
    rows = [*range(8), *range(47, 64)]
    steps = [
        tensor_map.model.search(own_signatures(tensor_map, row)).distances()[row + 1]
        for row in rows[:-1]
    ]
    assert own.resolution == pytest.approx(0.5 * np.median(steps))


def test_in_a_map_of_one_place_its_scans_say_what_is_near():
    tensor_map, _ = sample_harmonic_map(count=60)
    poses = np.repeat(tensor_map.trajectory.poses[:1], 60, axis=0)
    stood = replace(tensor_map, trajectory=replace(tensor_map.trajectory, poses=poses))
    changes = [
        tensor_map.model.search(own_signatures(tensor_map, row)).distances()[row + 1]
        for row in range(59)
    ]
    assert OwnDistances.of_map(stood).decision_distance < 11.0 * np.max(changes)


def test_where_nothing_is_nearer_beside_than_elsewhere_the_latter_counts():
    assert _half_way(0.5, 0.4) == _half_way(None, 0.4) == 0.4
    assert _half_way(0.1, None) is None


def test_distances_between_scans_of_a_large_map_are_compared_exactly_too(monkeypatch):
    ahead = Condition(disturb="fov:120")
    scans = [ahead.apply(scan, np.random.default_rng(0)) for scan in recording().scans]
    parameters = MapParameters.for_sensor(verification_images=False)
    tensor_map = build_map(MemoryDrive("narrow", scans), parameters)
    small = OwnDistances.of_map(tensor_map)
    monkeypatch.setattr(MaskedSearch, "most_exact", 10)
    large = OwnDistances.of_map(tensor_map)
    assert large.resolution == pytest.approx(small.resolution, rel=1e-3)
    assert large.decision_distance == pytest.approx(small.decision_distance, rel=1e-3)


def test_a_lost_vehicle_is_on_a_large_map_as_likely_as_on_a_small_one(monkeypatch):
    ahead = Condition(disturb="fov:120")
    mapped, driven = (
        [ahead.apply(scan, np.random.default_rng(0)) for scan in recording(noise_seed=seed).scans]
        for seed in (0, 1)
    )
    parameters = MapParameters.for_sensor(verification_images=False)
    tensor_map = build_map(MemoryDrive("narrow", mapped), parameters)
    basis, even = tensor_map.basis(), np.full(len(mapped), 0.5 / len(mapped))
    searched = Emission.of_map(tensor_map)
    monkeypatch.setattr(emission_module, "_FEW", 0)
    for scan in driven[::8]:
        signatures = basis.encode(basis.image(scan))
        small = searched.of_search(tensor_map.model.search(signatures), even, independence=0.0)
        with monkeypatch.context() as patch:
            patch.setattr(MaskedSearch, "most_exact", 10)
            large = searched.of_search(tensor_map.model.search(signatures), even, independence=0.0)
        assert np.log(large.max()) == pytest.approx(np.log(small.max()), abs=1e-3)


def test_a_view_counts_less_by_what_it_sees_less_than_the_map_s_own_scans():
    evidences = (1.0, 1.0), (0.8, 0.8), (0.8, 1.0), (1.0, 0.5)
    shares = (1.0, 1.0, 1.0, 0.5)

    def on_map(calibration):
        found = (emission(calibration, OwnDistances(0.02, 0.2, own), 1) for own, _ in evidences)
        near = np.array([0.1])
        return [
            np.log(one.likelihood(near, of_view)[0])
            for one, (_, of_view) in zip(found, evidences, strict=True)
        ]

    alone = 4.0 * np.log(0.2 / 0.1)
    assert on_map(None) == pytest.approx([share * alone for share in shares])
    is_near, at_decision = CALIBRATION.log_likelihood_ratio(np.array([0.1, 0.2]))
    is_right = CALIBRATION.log_odds(0.1, None)
    expected = [
        (share * is_near - at_decision + of_view * is_right) / 2.0
        for share, (_, of_view) in zip(shares, evidences, strict=True)
    ]
    assert on_map(CALIBRATION) == pytest.approx(expected)


def test_being_on_the_map_is_as_likely_as_a_fix_is_right_and_its_scan_is_near():
    own = OwnDistances(0.02, 0.2)
    found = emission(CALIBRATION, own, 2)
    for distance, ratio in ((0.1, 0.5), (0.1, 0.95), (0.3, 0.95), (0.1, None)):
        is_near, at_decision = CALIBRATION.log_likelihood_ratio(np.array([distance, 0.2]))
        is_right = CALIBRATION.log_odds(distance, ratio)
        of_scans = found.likelihood(np.array([distance, 0.9]), 1.0, ratio)
        evidence = (is_near - at_decision + is_right) / 2
        assert np.log(of_scans.mean()) == pytest.approx(evidence)
        repeated = found.likelihood(np.array([distance, 0.9]), 1.0, ratio, independence=0.0)
        assert np.log(repeated[0]) == pytest.approx(evidence)
        assert repeated[1] / repeated[0] == pytest.approx(of_scans[1] / of_scans[0])


def test_the_nearest_of_many_places_says_more_than_that_of_few_by_how_independent_it_is():
    def of_nearest(places, independence=1.0):
        found = emission(CALIBRATION, OwnDistances(0.02, 0.2), places)
        distances = np.array([0.3, *[0.9] * (places - 1)])
        return np.log(found.likelihood(distances, 1.0, 0.9, independence=independence)[0])

    assert of_nearest(1) == of_nearest(1, 0.0) == pytest.approx(of_nearest(40, 0.0))
    assert of_nearest(1) < of_nearest(4) < of_nearest(40)
    halves = of_nearest(40, 0.0) + of_nearest(40)
    assert of_nearest(40, 0.5) == pytest.approx(halves / 2)


def test_scans_that_were_not_compared_are_no_places_that_the_nearest_one_is_one_of():
    own, distances = OwnDistances(0.02, 0.2), np.array([0.3, 0.9, 0.9, *[np.inf] * 37])
    of_three = emission(CALIBRATION, own, 3).likelihood(distances[:3], 1.0, 0.9)
    of_forty = emission(CALIBRATION, own, 40).likelihood(distances, 1.0, 0.9)
    assert of_forty[:3] == pytest.approx(of_three)


def test_a_place_where_the_mapping_vehicle_stood_is_one_of_those_that_the_nearest_is_one_of():
    own, distances = OwnDistances(0.02, 0.2), np.array([0.3, *[0.9] * 39])
    drove = emission(CALIBRATION, own, 40)
    poses = POSES[:40].copy()
    poses[10:, 0] = 10.0
    stood = replace(drove, trajectory=replace(drove.trajectory, poses=poses))
    expected = emission(CALIBRATION, own, 11).likelihood(distances[:11], 1.0, 0.9)
    assert stood.likelihood(distances, 1.0, 0.9)[:11] == pytest.approx(expected)


def test_a_view_as_of_those_that_calibrated_the_map_counts_whole():
    wide, narrow = (
        emission(replace(CALIBRATION, evidence=evidence), OwnDistances(0.02, 0.2, 0.8), 2)
        for evidence in (1.0, 0.3)
    )
    near = np.array([0.1, 0.9])
    assert narrow.likelihood(near, 0.3, 0.5) == pytest.approx(wide.likelihood(near, 1.0, 0.5))
    assert narrow.likelihood(near, 0.3, 0.5)[0] > wide.likelihood(near, 0.3, 0.5)[0]


@dataclass(frozen=True)
class Counted(Search):
    """A search of known distances that notes what it was asked for."""

    exact: FloatArray
    least: FloatArray | None
    asked: list[str] = field(default_factory=list)

    def nearest(self, k, among=None):
        self.asked.append("runner-up")
        distances = self.exact if among is None else np.where(among, self.exact, np.inf)
        return Neighbours.of_distances(np.array([distances.argmin()]), distances.min()[None])

    def distances(self, among=None):
        self.asked.append("all")
        return self.exact

    def least_distances(self):
        return self.least

    def distances_of(self, rows):
        self.asked.append("some")
        return self.exact[rows]


SCANS = 400
POSES = np.eye(7)[[6] * SCANS]
POSES[:, 0] = np.arange(SCANS)
LINE = Trajectory(("a",), np.array([0, SCANS]), np.arange(SCANS), np.full(SCANS, np.nan), POSES)
CALIBRATION = Calibration(0.001, (3.0, -1.0, -6.0), (-3.0, -2.0), (-3.0, -2.0))


def emission(calibration, own, scans=SCANS):
    line = Trajectory(
        ("a",), np.array([0, scans]), np.arange(scans), np.full(scans, np.nan), POSES[:scans]
    )
    return Emission(calibration, own, line)


EMISSION = emission(None, OwnDistances(0.02, 0.2))
CALIBRATED = emission(CALIBRATION, OwnDistances(0.02, 0.2))


def a_search(nearest_row, **options):
    exact = np.full(SCANS, 0.8)
    exact[nearest_row] = 0.1
    return Counted(exact, 0.9 * exact, **options)


def belief_at(row, elsewhere_in_the_map):
    before = np.full(SCANS, elsewhere_in_the_map / SCANS)
    before[row - 2 : row + 3] += (1.0 - elsewhere_in_the_map) / 5
    return before


def test_of_a_belief_in_few_scans_these_and_the_nearest_are_compared():
    search, before = a_search(nearest_row=100), belief_at(100, 1e-4)
    found = EMISSION.of_search(search, before)
    assert search.asked == ["some"]
    expected = EMISSION.likelihood(search.exact)
    assert found[98:103] == pytest.approx(expected[98:103])
    after, wanted = before * found, before * expected
    assert after / after.sum() == pytest.approx(wanted / wanted.sum(), abs=1e-3)


def test_scans_of_a_hundred_thousandth_are_compared_where_those_of_a_thousandth_do_not_suffice():
    search, before = a_search(nearest_row=100), belief_at(100, 1e-4)
    before[110:113] += 5e-4
    search.least[:] = 0.8
    search.least[110:113] = 0.1
    search.least[:8] = 0.0
    found = EMISSION.of_search(search, before / before.sum())
    assert search.asked == ["some", "some"]
    assert found[108:115] == pytest.approx(EMISSION.likelihood(search.exact)[108:115])


def test_all_scans_are_compared_if_others_could_hold_a_thousandth_of_the_belief():
    carried_off = a_search(nearest_row=300)
    found = EMISSION.of_search(carried_off, belief_at(100, 1e-3))
    assert carried_off.asked == ["some", "all"]
    assert (found == EMISSION.likelihood(carried_off.exact)).all()


def test_all_scans_are_compared_of_an_even_belief_or_without_least_distances():
    even = a_search(nearest_row=100)
    EMISSION.of_search(even, np.full(SCANS, 1 / SCANS))
    plain = Counted(even.exact, None)
    EMISSION.of_search(plain, belief_at(100, 1e-4))
    assert even.asked == plain.asked == ["all"]


def test_all_scans_are_compared_while_a_vehicle_may_be_elsewhere_and_few_while_it_is_not():
    before = belief_at(100, 1e-5)
    on_map, may_be_elsewhere, uncalibrated = (a_search(nearest_row=100) for _ in range(3))
    of_few = CALIBRATED.of_search(on_map, before)
    of_all = CALIBRATED.of_search(may_be_elsewhere, 0.5 * before, independence=0.4)
    EMISSION.of_search(uncalibrated, 0.5 * before)
    assert on_map.asked == uncalibrated.asked == ["some"]
    assert may_be_elsewhere.asked == ["some", "all"]
    expected = CALIBRATED.likelihood(on_map.exact, 1.0, 0.1 / 0.8, independence=0.4)
    assert (of_all == expected).all()
    assert of_few[98:103] / of_few[100] == pytest.approx(expected[98:103] / expected[100])


class Estimated(Counted):
    """A search that estimates all distances as a third of what they are."""

    is_estimated = True

    def distances_for_belief(self):
        return self.exact / 3.0


def test_where_distances_are_estimates_the_exact_ones_say_whether_a_vehicle_is_on_the_map():
    exact = np.full(SCANS, 0.8)
    exact[100], exact[101] = 0.1, 0.2
    even = np.full(SCANS, 1 / SCANS)
    found = CALIBRATED.of_search(Estimated(exact, None), even, independence=0.0)
    expected = CALIBRATED.likelihood(exact, 1.0, 0.1 / 0.8, independence=0.0)
    assert found[100] == pytest.approx(expected[100])
    relative = CALIBRATED.likelihood(exact / 3.0)
    assert found / found[100] == pytest.approx(relative / relative[100])
    alone = replace(CALIBRATED, trajectory=replace(LINE, poses=np.eye(7)[[6] * SCANS]))
    found = alone.of_search(Estimated(exact, None), even)
    assert found[100] == pytest.approx(alone.likelihood(exact, 1.0, None)[100])


def test_a_scan_beside_the_nearest_is_no_runner_up():
    search = a_search(nearest_row=100)
    search.exact[91:100] = search.exact[101:110] = 0.11
    found = CALIBRATED.of_search(search, np.full(SCANS, 1 / SCANS))
    assert (found == CALIBRATED.likelihood(search.exact, 1.0, 0.1 / 0.8)).all()


def test_a_map_of_one_place_has_no_runner_up():
    search = a_search(nearest_row=100)
    of_place = replace(CALIBRATED, trajectory=replace(LINE, poses=np.eye(7)[[6] * SCANS]))
    found = of_place.of_search(search, np.full(SCANS, 1 / SCANS))
    assert (found == of_place.likelihood(search.exact, 1.0, None)).all()
    assert found[100] == pytest.approx(
        CALIBRATED.likelihood(search.exact, 1.0, None, independence=0.0)[100]
    )


def test_without_a_compared_scan_all_places_are_equally_likely():
    emission = Emission.of_map(sample_harmonic_map(count=40, segment_length=10)[0])
    assert (emission.likelihood(np.full(40, np.inf)) == 1.0).all()
