"""What of a demonstration can be checked, and what cannot."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.demo.errors import DemoFailed
from app.demo.run import _localize, _Query, _segments_at, _Way, hold_out
from core.progress import NO_PROGRESS
from core.scans.scan import Scan
from tests.support.samples import sample_drive

BEST = SimpleNamespace(
    segment=1,
    pose=SimpleNamespace(x_m=3.0, y_m=4.0, z_m=0.0),
    estimated_pose=SimpleNamespace(x_m=3.0, y_m=1.0, z_m=0.0),
)
CLIENT: Any = SimpleNamespace(localize=lambda kind, body: SimpleNamespace(best=BEST))
WAY = _Way("full scan", "scan", lambda query: query.body)


@pytest.mark.parametrize(
    ("x_m", "recall", "error_m"), [(3.0, 0.0, 1.0), (np.nan, None, None)], ids=["known", "unknown"]
)
def test_metres_are_checked_where_the_held_out_scans_have_poses(x_m, recall, error_m):
    drive: Any = SimpleNamespace(poses=np.array([[x_m, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]))
    query = _Query(0, (1,), Scan(np.ones((1, 3), np.float32)), b"body")
    fixes = _localize(CLIENT, WAY, [query], drive, {1: 0}, NO_PROGRESS)
    assert (fixes.recall_at_1, fixes.position_error_m) == (recall, error_m)
    assert fixes.segment_accuracy == 1.0


def test_a_held_out_scan_between_two_segments_is_of_either():
    # Scans 2, 4 and 7 are held out; the map's rows 0 to 2 are segment 0, 3 to 4 segment 1.
    recorded, starts = [0, 1, 3, 5, 6], [0, 3]
    assert [_segments_at(starts, recorded, scan) for scan in (2, 4, 7)] == [(0,), (0, 1), (1,)]
    assert _segments_at([0], [1, 2], 0) == (0,)


@pytest.mark.parametrize(("segments", "share"), [((0,), 0.0), ((0, 1), 1.0)])
def test_an_answer_on_either_segment_of_a_scan_is_right(segments, share):
    drive: Any = SimpleNamespace(poses=np.full((1, 7), np.nan))
    query = _Query(0, segments, Scan(np.ones((1, 3), np.float32)), b"body")
    fixes = _localize(CLIENT, WAY, [query], drive, {0: 0, 1: 1}, NO_PROGRESS)
    assert fixes.segment_accuracy == share


def test_a_drive_of_one_scan_is_too_short():
    with pytest.raises(DemoFailed, match="drive one has 1 scan: too few"):
        hold_out(sample_drive(1, name="one"))
