"""How different two consecutive observations are."""

from dataclasses import replace

import numpy as np
import pytest

from core.evaluation.selected import SelectedScans
from core.mapping.pipeline import build
from core.parameters import MapParameters
from core.scans.drive import MemoryDrive
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from core.tracking.stationary import StationaryDetector, StationaryModel, change
from tests.support.samples import own_signatures, sample_harmonic_map, sample_map


@pytest.fixture(scope="module", params=[sample_map, sample_harmonic_map])
def mapped(request):
    return request.param(count=40, segment_length=10)[0]


def test_the_change_is_zero_for_one_scan_and_larger_for_another(mapped):
    here, there = own_signatures(mapped, 3), own_signatures(mapped, 4)
    assert change(here, here) == pytest.approx(0.0, abs=1e-7)
    assert (change(here, there) or 0.0) > 0.01
    assert change(here, ()) is None


def test_signatures_of_other_ranks_are_compared_in_those_that_both_have(mapped):
    whole = own_signatures(mapped, 3)
    narrow = [replace(one, values=one.values[:, :-1]) for one in whole]
    low = [replace(one, values=one.values[:-1]) for one in whole]
    assert change(narrow, low) == pytest.approx(0.0, abs=1e-7)
    assert change(low, whole) == pytest.approx(0.0, abs=1e-7)


def test_a_moving_vehicle_is_not_stationary_however_far_apart_the_scans_of_the_map_are():
    drive = SimulatedDrive(seed=12, scans=90, stops=False, sensor=SimulatedSensor(firings=90))
    mapped = SelectedScans(drive, np.arange(0, len(drive), 6))  # 9 m apart
    parameters = MapParameters.for_sensor(encoding="harmonic")
    tensor_map = build([mapped], parameters, calibrated=False).tensor_map
    basis = tensor_map.basis()
    detector = StationaryDetector(StationaryModel.of_map(tensor_map))
    driven = [basis.encode(basis.image(scan)) for scan in drive]
    assert sum(map(detector.update, driven)) <= 0.2 * len(driven)
    assert sum(detector.update(driven[-1]) for _ in range(10)) >= 9


def test_an_observation_is_independent_by_its_change_since_the_place_where_the_vehicle_stopped(
    mapped,
):
    here, there = own_signatures(mapped, 3), own_signatures(mapped, 4)
    changed = change(here, there) or 0.0
    of_step = 0.8 * changed
    model = StationaryModel(0.4 * of_step, np.zeros(len(mapped), np.bool_))
    both = zip(here, there, strict=True)
    near = [replace(a, values=0.8 * a.values + 0.2 * b.values) for a, b in both]
    assert (change(here, near) or 0.0) < model.threshold < changed

    def independence(detector):
        for signatures in (here, here, near, there, ()):
            detector.update(signatures)
            yield detector.independence

    of_step_twice = changed / (2.0 * of_step)
    new, resumed = (
        list(independence(StationaryDetector(model, resumed=resumed))) for resumed in (False, True)
    )
    assert new == pytest.approx([1.0, 0.0, 0.0, of_step_twice, 0.0])
    assert resumed == [0.0, *new[1:]]
    assert model.independence(9.0 * changed) == 1.0


def test_where_no_change_of_a_moving_vehicle_is_known_no_observation_but_the_first_is_independent():
    model = StationaryModel(0.0, np.zeros(3, np.bool_))
    assert model.independence(0.0) == model.independence(0.3) == 0.0


def test_a_vehicle_that_stands_is_found_in_a_map_whose_vehicle_stood_most_of_the_time():
    drive = list(SimulatedDrive(seed=12, scans=30, stops=False, sensor=SimulatedSensor(firings=90)))
    rng = np.random.default_rng(4)

    def again(scan):
        noise_m = rng.normal(scale=0.02, size=scan.points_m.shape)
        return replace(scan, points_m=(scan.points_m + noise_m).astype(np.float32))

    stood = [again(drive[15]) for _ in range(150)]
    mapped = MemoryDrive("stood", [*drive[:15], *stood, *drive[15:]])
    parameters = MapParameters.for_sensor(encoding="harmonic")
    tensor_map = build([mapped], parameters, calibrated=False).tensor_map
    basis, model = tensor_map.basis(), StationaryModel.of_map(tensor_map)
    detector = StationaryDetector(model)
    found = [detector.update(basis.encode(basis.image(again(drive[15])))) for _ in range(20)]
    assert sum(found) >= 17
    assert model.stopped[15:165].all()
    assert not model.stopped[:14].any()
