"""How much likelier wrong matches seem within limits is measured on a map's own scans."""

from unittest.mock import Mock

import numpy as np
import pytest

from core.confidence.calibration import Calibration
from core.encodings.harmonic.query_limits import limits_of_scan
from core.evaluation.condition import Condition
from core.mapping.limited_queries import LimitedScans
from core.mapping.pipeline import build
from core.parameters import MapParameters
from core.projection.visibility import View
from core.scans.drive import MemoryDrive
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor

SCANS = 60
TRUST = Calibration(
    floor=0.01, both=(3.0, -5.0, -13.0), alone=(-14.0, -12.0), likelihood=(-6.0, -8.0)
)


def map_of(disturbance, scans=SCANS):
    drive = SimulatedDrive(seed=8103, scans=scans, sensor=SimulatedSensor(firings=400))
    rng = np.random.default_rng(5)
    seen = [Condition(disturb=disturbance).apply(drive.scan(i), rng) for i in range(scans)]
    parameters = MapParameters.for_sensor()
    return build([MemoryDrive("seen", seen)], parameters, calibrated=False).tensor_map


@pytest.fixture(scope="module")
def all_around():
    return map_of("")


def limits_of(hidden):
    limits = limits_of_scan((8, 12), View(tuple(range(hidden))), 20)
    assert limits is not None
    return limits


def test_a_scan_of_the_map_has_no_cell_beyond_the_reach_of_its_limits(all_around):
    limits = limits_of_scan((8, 12), View(tuple(range(45)), 6), 20)
    assert limits is not None
    assert limits.view.rings == 5
    search = all_around.model.search_own(10, limits)
    assert search is not None
    assert search._query._rings <= limits.view.rings


def gained(tensor_map, hidden):
    limits = limits_of(hidden)
    return LimitedScans(tensor_map.model, tensor_map.trajectory, TRUST).odds_gained(limits)


def test_the_less_is_seen_the_likelier_wrong_matches_seem(all_around):
    assert 0.0 < gained(all_around, 40) < gained(all_around, 45) < gained(all_around, 50)


def test_a_map_of_a_narrow_sensor_is_calibrated_for_what_that_sees(all_around):
    narrow = map_of("fov:90")
    assert gained(narrow, 45) < 0.3 * gained(all_around, 45)
    assert gained(narrow, 55) > 1.0


def test_where_nothing_was_recorded_elsewhere_nothing_is_measured():
    assert gained(map_of("", scans=4), 45) == 0.0


def test_what_whole_scans_find_is_searched_once_for_all_limits(all_around):
    model = Mock(wraps=all_around.model)
    measured = LimitedScans(model, all_around.trajectory, TRUST)
    for hidden in (45, 40):
        assert measured.odds_gained(limits_of(hidden)) == gained(all_around, hidden)
    whole = [asked.args[0] for asked in model.search_own.mock_calls if len(asked.args) == 1]
    assert len(whole) > SCANS / 4
    assert len(whole) == len(set(whole))
