"""Consecutive scans that become one."""

import numpy as np
import pytest

from core.errors import InvalidParameters, InvalidScan
from core.scans.accumulation import (
    FARTHEST_M,
    MOST_RETURNS,
    MOST_SCANS,
    AccumulatedDrive,
    accumulate,
    accumulated_scan,
)
from core.scans.pose import Pose
from core.scans.scan import Scan
from tests.support.samples import FaultyDrive, sample_drive, sample_points, straight_poses


def test_returns_lie_where_they_were_seen_from_the_last_scan():
    scans = [Scan(sample_points(i), timestamp_s=float(i)) for i in range(3)]
    half = np.radians(45.0) / 2
    rows = straight_poses(3)
    rows[1, 3:] = [0.0, 0.0, np.sin(half), np.cos(half)]
    merged = accumulate(scans, rows)
    assert len(merged) == sum(map(len, scans))
    assert merged.timestamp_s == 2.0
    np.testing.assert_allclose(merged.points_m[:60], scans[0].points_m - [2.0, 0, 0], atol=1e-5)
    x, y, z = scans[1].points_m.astype(np.float64).T
    turned = np.column_stack([(x - y) / np.sqrt(2) - 1.0, (x + y) / np.sqrt(2), z])
    np.testing.assert_allclose(merged.points_m[60:120], turned, atol=1e-5)
    np.testing.assert_array_equal(merged.points_m[120:], scans[2].points_m)


def test_one_scan_is_itself_and_needs_no_pose():
    scan = Scan(sample_points(0))
    assert accumulate([scan], np.full((1, 7), np.nan)) is scan


@pytest.mark.parametrize("known", [0, 1])
def test_scans_without_a_pose_are_refused(known):
    rows = np.full((2, 7), np.nan)
    rows[known] = straight_poses(1)[0]
    with pytest.raises(InvalidScan, match=f"scan {1 - known} of 2 .* has no pose"):
        accumulate([Scan(sample_points(0))] * 2, rows)


def test_scans_that_are_too_far_apart_are_refused():
    rows = straight_poses(2, FARTHEST_M + 1.0)
    with pytest.raises(InvalidScan, match="101 m from the last one, wanted at most 100"):
        accumulate([Scan(sample_points(0))] * 2, rows)


def test_too_many_scans_or_returns_are_refused():
    scan = Scan(sample_points(0))
    for count in (0, MOST_SCANS + 1):
        with pytest.raises(InvalidScan, match=f"wanted 1 to {MOST_SCANS}"):
            accumulate([scan] * count, straight_poses(count))
    large = Scan(np.ones((MOST_RETURNS // 2 + 1, 3), dtype=np.float32))
    with pytest.raises(InvalidScan, match=f"wanted at most {MOST_RETURNS}"):
        accumulate([large, large], straight_poses(2))
    with pytest.raises(InvalidScan, match="shape"):
        accumulate([scan, scan], straight_poses(3))


@pytest.mark.parametrize(
    ("scans", "count", "ends"),
    [(9, 3, [2, 5, 8]), (10, 3, [2, 5, 8, 9]), (2, 5, [1]), (0, 2, []), (4, 1, [0, 1, 2, 3])],
)
def test_each_scan_of_a_drive_is_in_one_of_the_accumulated(scans, count, ends):
    drive = sample_drive(scans)
    accumulated = AccumulatedDrive(drive, count)
    assert accumulated.scan_index.tolist() == ends
    assert len(accumulated) == len(ends)
    np.testing.assert_array_equal(accumulated.poses, drive.poses[ends])
    np.testing.assert_array_equal(accumulated.timestamp_s, drive.timestamp_s[ends])
    returns = [len(accumulated.scan(i)) for i in range(len(ends))]
    assert sum(returns) == 60 * scans
    for index, end in enumerate(ends):
        scan = accumulated.scan(index)
        np.testing.assert_array_equal(scan.points_m[-60:], drive.scan(end).points_m)
        assert scan.pose == Pose.from_row(drive.poses[end])


def test_a_window_ends_at_its_scan_and_begins_in_the_drive():
    drive = sample_drive(5)
    assert [len(accumulated_scan(drive, at, 3)) // 60 for at in range(5)] == [1, 2, 3, 3, 3]


def test_a_scan_that_cannot_be_used_makes_its_whole_block_unusable():
    accumulated = AccumulatedDrive(FaultyDrive(sample_drive(6), {1}), 3)
    with pytest.raises(InvalidScan, match="torn"):
        accumulated.scan(0)
    assert len(accumulated.scan(1)) == 180


@pytest.mark.parametrize("count", [0, MOST_SCANS + 1])
def test_a_number_of_scans_out_of_range_is_refused(count):
    with pytest.raises(InvalidParameters, match=f"accumulate is {count}, wanted 1 to {MOST_SCANS}"):
        AccumulatedDrive(sample_drive(2), count)
