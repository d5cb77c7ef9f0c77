"""Scans hold possible returns only, and errors have what was expected."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from core.errors import InvalidScan, TooFewReturns
from core.scans import scan as module
from core.scans.pose import Pose
from core.scans.scan import Scan

POINTS = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], dtype=np.float32)


@pytest.mark.parametrize("shape", [(3,), (2, 2), (2, 4), (1, 2, 3), (0,)])
def test_a_scan_is_n_by_3(shape):
    with pytest.raises(InvalidScan, match=r"wanted \(n, 3\)"):
        Scan(np.ones(shape, np.float32))
    with pytest.raises(InvalidScan, match=r"wanted \(n, 3\)"):
        Scan.from_returns(np.ones(shape))


@pytest.mark.parametrize("row", [[np.nan, 1, 1], [np.inf, 1, 1], [0, 0, 0], [0, -0.0, 0]])
def test_a_scan_holds_finite_returns_away_from_the_origin_only(row):
    with pytest.raises(InvalidScan, match="not finite or zero"):
        Scan(np.array([row, [1, 2, 3]], dtype=np.float32))
    scan = Scan.from_returns(np.array([row, [1.0, 2.0, 3.0]]))
    assert (len(scan), scan.dropped_returns) == (1, 1)


def test_a_coordinate_beyond_float32_is_no_return():
    assert Scan.from_returns([[1e300, 0.0, 0.0], [1.0, 0.0, 0.0]]).dropped_returns == 1
    with pytest.raises(InvalidScan, match="not finite"):
        Scan(np.array([[1e300, 0, 0]]))


def test_too_few_returns_are_counted():
    with pytest.raises(TooFewReturns, match="1 of 2 returns are finite and non-zero, at least 2"):
        Scan.from_returns([[1, 2, 3], [0, 0, 0]], min_returns=2)
    with pytest.raises(TooFewReturns, match="0 of 0"):
        Scan.from_returns(np.empty((0, 3)))


@pytest.mark.parametrize("timestamp_s", [math.inf, -math.inf])
def test_a_time_is_a_number_of_seconds_or_unknown(timestamp_s):
    with pytest.raises(InvalidScan, match="timestamp_s is"):
        Scan(POINTS, timestamp_s=timestamp_s)


def test_a_scan_cannot_be_written_through_and_leaves_its_callers_array_writable():
    points = POINTS.copy()
    scan = Scan(points)
    with pytest.raises(ValueError, match="read-only"):
        scan.points_m[0, 0] = 9.0
    points[0, 0] = 9.0


def test_a_scan_is_shown_by_the_number_of_its_returns_and_without_them() -> None:
    shown = repr(Scan.from_returns([[10.0, 0.0, 0.0], [0.0, 0.0, 0.0]], timestamp_s=2.5))
    assert shown == (
        "Scan(returns=1, timestamp_s=2.5, pose=None, dropped_returns=1, is_level=False)"
    )


@pytest.mark.parametrize("dropped", [0, 1])
def test_returns_are_checked_once_and_are_the_scan_that_the_constructor_makes(monkeypatch, dropped):
    checks = []

    def counted(points_m):
        checks.append(len(points_m))
        return is_return(points_m)

    is_return = module._is_return
    monkeypatch.setattr(module, "_is_return", counted)
    pose = Pose(1.0, 2.0, 3.0)
    returns_m = np.concatenate([POINTS, np.zeros((dropped, 3), np.float32)])
    scan = Scan.from_returns(returns_m, timestamp_s=2.5, pose=pose)
    assert checks == [2 + dropped]
    made = Scan(POINTS, timestamp_s=2.5, pose=pose, dropped_returns=dropped)
    assert checks == [2 + dropped, 2]
    assert vars(scan).keys() == vars(made).keys() == {field.name for field in fields(Scan)}
    np.testing.assert_array_equal(scan.points_m, made.points_m)
    assert scan.points_m.dtype == made.points_m.dtype
    assert repr(scan) == repr(made)
    assert replace(scan, is_level=True).is_level
    with pytest.raises(ValueError, match="read-only"):
        scan.points_m[0] = 7.0
    returns_m[0] = 7.0  # its owner may still write
    with pytest.raises(InvalidScan, match="timestamp_s is inf"):
        Scan.from_returns(POINTS, timestamp_s=math.inf)
