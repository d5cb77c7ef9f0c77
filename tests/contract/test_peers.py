"""What every re-derived peer promises, asked of each of them."""

import numpy as np
import pytest

from core.errors import InvalidParameters
from core.evaluation.baselines.descriptor import sent_bytes
from core.evaluation.baselines.m2dp import M2dp
from core.evaluation.baselines.scan_context import ScanContext
from core.evaluation.baselines.solid import Solid
from core.evaluation.condition import Condition
from core.scans.scan import Scan
from core.simulation import SimulatedDrive, SimulatedSensor

# A peer joins by its descriptor, the numbers in it, and whether it tells the heading.
PEERS = {
    "scan context": (ScanContext(), 1200, True),
    "scan context, ring key": (ScanContext(candidates=3), 1200, True),
    "solid": (Solid(), 100, True),
    "m2dp": (M2dp(), 192, False),
}


@pytest.fixture(scope="module")
def scans():
    drive = SimulatedDrive(seed=21, scans=40, sensor=SimulatedSensor(firings=360), stops=False)
    return [drive.scan(i) for i in range(0, 40, 4)]


@pytest.fixture(params=sorted(PEERS))
def case(request):
    return PEERS[request.param]


@pytest.fixture
def peer(case):
    return case[0]


@pytest.fixture
def places(peer, scans):
    return peer.places(np.stack([peer.describe(scan) for scan in scans]))


def turned(scan: Scan, yaw_deg: float) -> Scan:
    return Condition(yaw_deg=yaw_deg).apply(scan, np.random.default_rng(0))


class TestPeers:
    def test_a_descriptor_has_the_shape_and_bytes_of_the_paper(self, case, scans):
        peer, numbers, _ = case
        described = peer.describe(scans[0])
        assert (described.shape, described.dtype) == (peer.shape, np.float32)
        assert described.size == numbers
        assert sent_bytes(peer) == described.nbytes == 4 * numbers

    def test_the_same_scan_gives_the_same_descriptor(self, peer, scans):
        np.testing.assert_array_equal(peer.describe(scans[0]), peer.describe(scans[0]))

    def test_the_order_of_returns_does_not_matter(self, peer, scans):
        shuffled = Scan(np.random.default_rng(0).permutation(scans[0].points_m))
        described = peer.describe(scans[0])
        np.testing.assert_allclose(
            peer.describe(shuffled), described, rtol=1e-3, atol=1e-3 * np.abs(described).max()
        )

    def test_a_place_is_nearest_to_itself(self, peer, places, scans):
        for row, scan in enumerate(scans):
            found = places.nearest(peer.describe(scan))
            assert found is not None
            assert found.row == row
            assert found.distance == pytest.approx(0.0, abs=1e-5)
            assert found.turn_deg in {None, 0.0}

    @pytest.mark.parametrize("yaw_deg", [90.0, 180.0, -90.0])
    def test_a_turn_changes_no_answer_and_is_told_where_the_paper_tells_it(
        self, case, places, scans, yaw_deg
    ):
        peer, _, tells_heading = case
        for row, scan in enumerate(scans):
            found = places.nearest(peer.describe(turned(scan, yaw_deg)))
            assert found is not None
            assert found.row == row
            if not tells_heading:
                assert found.turn_deg is None
                continue
            error_deg = (found.turn_deg - yaw_deg + 180.0) % 360.0 - 180.0
            assert abs(error_deg) <= 6.0

    def test_only_rows_before_the_given_one_are_answered(self, peer, places, scans):
        query = peer.describe(scans[7])
        for before in range(1, len(scans) + 1):
            found = places.nearest(query, before)
            assert found is not None
            assert found.row < before
            assert (found.row == 7) == (before > 7)
        assert places.nearest(query, 0) is None
        assert places.nearest(query, len(scans) + 5) == places.nearest(query)

    def test_what_is_kept_is_at_least_the_descriptors(self, peer, places, scans):
        assert len(places) == len(scans)
        assert places.stored_bytes >= len(scans) * sent_bytes(peer)

    def test_no_place_answers_nothing(self, peer, scans):
        nowhere = peer.places(np.empty((0, *peer.shape), np.float32))
        assert len(nowhere) == 0
        assert nowhere.nearest(peer.describe(scans[0])) is None

    def test_descriptors_of_another_shape_are_refused(self, peer):
        with pytest.raises(InvalidParameters, match="descriptors have shape"):
            peer.places(np.zeros((3, 7), np.float32))

    def test_the_configuration_is_plain_values(self, peer):
        assert peer.name
        assert all(isinstance(v, int | float | None) for v in peer.configuration().values())
