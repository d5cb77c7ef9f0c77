"""What of a demonstration can be checked, and what cannot."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.demo.run import _localize, _Query, _Way
from core.progress import NO_PROGRESS
from core.scans.scan import Scan

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
    query = _Query(0, 1, Scan(np.ones((1, 3), np.float32)), b"body")
    fixes = _localize(CLIENT, WAY, [query], drive, {1: 0}, NO_PROGRESS)
    assert (fixes.recall_at_1, fixes.position_error_m) == (recall, error_m)
    assert fixes.segment_accuracy == 1.0
