"""The contract of every re-derived baseline."""

import numpy as np
import pytest

from baselines.m2dp import M2dp
from baselines.scan_context import ScanContext
from baselines.solid import Solid
from core.evaluation.condition import Condition
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor

# By name: the baseline, the size of its descriptor, and whether it estimates relative yaw.
BASELINES = {
    "scan context": (ScanContext(), 1200, True),
    "scan context, ring key": (ScanContext(candidates=3), 1200, True),
    "solid": (Solid(), 100, True),
    "m2dp": (M2dp(), 192, False),
}


@pytest.fixture(scope="module")
def scans():
    drive = SimulatedDrive(seed=21, scans=40, sensor=SimulatedSensor(firings=360), stops=False)
    return [drive.scan(i) for i in range(0, 40, 4)]


@pytest.fixture(params=sorted(BASELINES))
def case(request):
    return BASELINES[request.param]


@pytest.fixture
def baseline(case):
    return case[0]


@pytest.fixture
def places(baseline, scans):
    return baseline.places(np.stack([baseline.describe(scan) for scan in scans]))


def with_yaw(scan: Scan, yaw_deg: float) -> Scan:
    return Condition(yaw_deg=yaw_deg).apply(scan, np.random.default_rng(0))


class TestBaselines:
    def test_a_descriptor_has_the_shape_and_bytes_of_the_paper(self, case, scans):
        baseline, numbers, _ = case
        described = baseline.describe(scans[0])
        assert (described.shape, described.dtype) == (baseline.shape, np.float32)
        assert described.size == numbers
        assert described.nbytes == 4 * numbers

    def test_the_same_scan_gives_the_same_descriptor(self, baseline, scans):
        np.testing.assert_array_equal(baseline.describe(scans[0]), baseline.describe(scans[0]))

    def test_the_order_of_returns_does_not_matter(self, baseline, scans):
        shuffled = Scan(np.random.default_rng(0).permutation(scans[0].points_m))
        described = baseline.describe(scans[0])
        np.testing.assert_allclose(
            baseline.describe(shuffled), described, rtol=1e-3, atol=1e-3 * np.abs(described).max()
        )

    def test_a_place_is_nearest_to_itself(self, baseline, places, scans):
        for row, scan in enumerate(scans):
            found = places.nearest(baseline.describe(scan))
            assert found is not None
            assert found.row == row
            assert found.distance == pytest.approx(0.0, abs=1e-5)
            assert found.relative_yaw_deg in {None, 0.0}

    @pytest.mark.parametrize("yaw_deg", [90.0, 180.0, -90.0])
    def test_relative_yaw_changes_no_answer_and_is_estimated_where_the_paper_does(
        self, case, places, scans, yaw_deg
    ):
        baseline, _, has_yaw = case
        for row, scan in enumerate(scans):
            found = places.nearest(baseline.describe(with_yaw(scan, yaw_deg)))
            assert found is not None
            assert found.row == row
            if not has_yaw:
                assert found.relative_yaw_deg is None
                continue
            error_deg = (found.relative_yaw_deg - yaw_deg + 180.0) % 360.0 - 180.0
            assert abs(error_deg) <= 6.0

    def test_only_rows_before_the_given_one_are_answered(self, baseline, places, scans):
        query = baseline.describe(scans[7])
        for before in range(1, len(scans) + 1):
            found = places.nearest(query, before)
            assert found is not None
            assert found.row < before
            assert (found.row == 7) == (before > 7)
        assert places.nearest(query, 0) is None
        assert places.nearest(query, len(scans) + 5) == places.nearest(query)

    def test_at_least_the_descriptors_are_stored(self, case, places, scans):
        assert len(places) == len(scans)
        assert places.stored_bytes >= len(scans) * 4 * case[1]

    def test_no_place_answers_nothing(self, baseline, scans):
        nowhere = baseline.places(np.empty((0, *baseline.shape), np.float32))
        assert len(nowhere) == 0
        assert nowhere.nearest(baseline.describe(scans[0])) is None

    def test_the_configuration_is_plain_values(self, baseline):
        assert baseline.name
        assert all(isinstance(v, int | float | None) for v in baseline.configuration().values())
