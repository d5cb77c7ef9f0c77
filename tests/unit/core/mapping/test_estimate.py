"""Estimates between the scans of a map and their virtual viewpoints."""

import numpy as np
import pytest

from core.encodings.search import DistanceSearch, Search, Viewpoints
from core.mapping.estimate import Estimate, estimate, share_left
from core.scans.pose import UNKNOWN_POSE
from core.scans.trajectory import Trajectory

OFFSETS_M = np.array([-3.0, -1.5, 0.0, 1.5, 3.0])
NUMBERS = 90


class _Field(Search):
    """A search in a map of which each place has numbers that change evenly, along and across.

    The query is `ahead_m` along the path, `left_m` beside it, and turned by `turn_deg`.
    """

    def __init__(self, ahead_m, left_m, turn_deg=0.0, offsets_m=OFFSETS_M):
        self.vectors = np.random.default_rng(0).normal(size=(4, NUMBERS))
        self.offsets_m = np.array(offsets_m)
        self.turn_deg, self.asked = turn_deg, []
        self.query = self.at(ahead_m, left_m, 0.0)

    def nearest(self, k, among=None):
        raise NotImplementedError

    def distances(self, among=None):
        raise NotImplementedError

    def at(self, ahead_m, left_m, off_deg):
        steps = np.array([10.0, ahead_m / 3.0, left_m / 3.0, off_deg / 4.0])
        return steps @ self.vectors

    def viewpoints(self, rows, relative_yaw_deg):
        self.asked.append(rows.tolist())
        off_deg = relative_yaw_deg - self.turn_deg + np.array([[-4.0], [0.0], [4.0]])
        seen = [
            [
                [self.at(4.0 * row, left_m, off) for left_m in self.offsets_m]
                for row, off in zip(rows, offs, strict=True)
            ]
            for offs in off_deg
        ]
        return Viewpoints(self.query, np.array(seen), 4.0, self.offsets_m)


def _path(scans, gap_m=4.0, drives=1):
    """A straight path to the east, cut into drives of equal length."""
    poses = np.zeros((scans, 7))
    poses[:, 0], poses[:, 6] = gap_m * np.arange(scans), 1.0
    each = scans // drives
    return Trajectory.concatenate(
        [
            Trajectory.of_drive(
                f"d{drive}",
                np.arange(each, dtype=np.float64),
                poses[drive * each : (drive + 1) * each],
                np.arange(each),
            )
            for drive in range(drives)
        ]
    )


def _xy(found: Estimate):
    assert found.pose is not None
    return found.pose.x_m, found.pose.y_m


@pytest.mark.parametrize("ahead_m", [4.0, 5.0, 6.0, 7.5])
@pytest.mark.parametrize("left_m", [-3.0, -0.7, 0.0, 2.2])
def test_a_query_between_scans_and_viewpoints_is_placed_between_them(ahead_m, left_m):
    found = estimate(_Field(ahead_m, left_m), _path(3), 1, 0.0)
    assert _xy(found) == pytest.approx((ahead_m, left_m), abs=0.25)
    assert found.lateral_m == pytest.approx(left_m, abs=0.25)


def test_a_query_beyond_the_outermost_viewpoint_is_placed_beyond_it():
    found = estimate(_Field(5.0, 4.6), _path(3), 1, 0.0)
    assert _xy(found) == pytest.approx((5.0, 4.6), abs=0.3)


@pytest.mark.parametrize("turn_deg", [-2.5, 0.0, 3.0, 179.0])
def test_the_heading_is_refined_between_those_that_were_searched(turn_deg):
    found = estimate(_Field(5.0, 1.0, turn_deg), _path(3), 1, turn_deg - 1.5)
    assert found.relative_yaw_deg == pytest.approx(turn_deg, abs=0.3)


def test_only_the_scans_before_and_after_in_the_drive_and_near_are_used():
    for trajectory, row, used in (
        (_path(9), 4, [3, 4, 5]),
        (_path(9), 0, [0, 1]),
        (_path(9), 8, [7, 8]),
        (_path(8, drives=2), 3, [2, 3]),
        (_path(9, gap_m=11.0), 4, [4]),
        (_path(1), 0, [0]),
    ):
        search = _Field(4.0 * row, 0.5)
        found = estimate(search, trajectory, row, 0.0)
        assert search.asked[0] == used
        assert found.lateral_m == pytest.approx(0.5, abs=0.25)


def test_a_scan_that_must_not_be_used_is_left_out_and_the_next_one_taken():
    search = _Field(12.0, 0.0)
    among = np.ones(9, dtype=bool)
    among[[2, 4]] = False
    estimate(search, _path(9), 3, 0.0, among)
    assert search.asked == [[1, 3, 5]]


def test_without_poses_offset_and_heading_are_of_the_scan_alone():
    trajectory = Trajectory.of_drive(
        "d", np.arange(3.0), np.tile(UNKNOWN_POSE, (3, 1)), np.arange(3)
    )
    search = _Field(4.0, 1.0, 30.0)
    found = estimate(search, trajectory, 1, 29.0)
    assert search.asked == [[1]]
    assert found.pose is None
    assert found.lateral_m == pytest.approx(1.0, abs=0.25)
    assert found.relative_yaw_deg == pytest.approx(30.0, abs=0.3)


def test_an_unknown_heading_stays_unknown():
    assert estimate(_Field(5.0, 0.0), _path(3), 1, None).relative_yaw_deg is None


def test_an_encoding_without_viewpoints_has_no_estimate():
    search = DistanceSearch((0,), np.arange(3), np.zeros(3), 3)
    assert estimate(search, _path(3), 1, None) == Estimate()


def test_a_query_without_anything_in_it_is_placed_somewhere_near():
    search = _Field(5.0, 0.0)
    search.query = np.zeros(NUMBERS)
    x_m, y_m = _xy(estimate(search, _path(3), 1, 0.0))
    assert 0.0 <= x_m <= 8.0
    assert abs(y_m) <= 6.0


def test_of_a_query_between_scans_and_viewpoints_little_of_its_distance_is_left():
    assert share_left(_Field(5.0, 0.7), _path(3), 1, 0.0) < 0.1
    assert share_left(_Field(4.0, 1.5), _path(3), 1, 0.0) == 1.0  # a scan's own viewpoint


def test_of_a_query_of_elsewhere_most_of_its_distance_is_left():
    search = _Field(5.0, 0.7)
    search.query = np.random.default_rng(1).normal(size=NUMBERS)
    assert 0.9 < share_left(search, _path(3), 1, 0.0) <= 1.0


@pytest.mark.parametrize(
    ("left_m", "offsets_m"),
    [(5.0, OFFSETS_M), (-2.0, (-1.0, 0.0, 3.0)), (2.0, (-3.0, 0.0, 1.0)), (-2.0, (0.0, 3.0))],
)
def test_means_beyond_the_outermost_viewpoints_do_not_count(left_m, offsets_m):
    search = _Field(4.0, left_m, offsets_m=offsets_m)
    assert share_left(search, _path(3), 1, 0.0) == pytest.approx(1.0, abs=0.01)


def test_without_viewpoints_all_of_the_distance_is_left():
    search = DistanceSearch((0,), np.arange(3), np.ones(3), 3)
    assert share_left(search, _path(3), 1, None) == 1.0
