"""Loop closures of a vehicle that comes back in the opposite direction: sparse, tilted scans."""

import numpy as np
import pytest

from core.loop_closure.closure import ClosureDecision, check_scans
from core.scans.drive import Drive
from tests.support.recorded_drives import Drives

pytestmark = pytest.mark.real_data

SENSOR_HEIGHT_M = 0.95
AFTER_S = 30.0


def counted(drive: Drive, pairs: list[tuple[int, int]]) -> dict[ClosureDecision, int]:
    decisions = [
        check_scans(drive.scan(first), drive.scan(second), SENSOR_HEIGHT_M).decide()
        for first, second in pairs
    ]
    return {decision: decisions.count(decision) for decision in ClosureDecision}


def test_true_closures_are_accepted_and_those_elsewhere_are_not(drives: Drives) -> None:
    drive = drives.open("nclt_turn")
    place_m, time_s = drive.poses[:, :3], drive.timestamp_s
    closures = []
    for second in range(len(drive)):
        before = np.flatnonzero(time_s < time_s[second] - AFTER_S)
        apart_m = np.linalg.norm(place_m[before] - place_m[second], axis=1)
        if apart_m.min(initial=np.inf) <= 3.0:
            closures.append((int(before[apart_m.argmin()]), second))
    found = counted(drive, closures)
    assert len(closures) == 73
    assert found[ClosureDecision.ACCEPTED] >= 60
    assert found[ClosureDecision.REJECTED] <= 2

    pairs = np.random.default_rng(0).integers(len(drive), size=(10_000, 2))
    far = np.linalg.norm(place_m[pairs[:, 0]] - place_m[pairs[:, 1]], axis=1) > 25.0
    elsewhere = [(first, second) for first, second in pairs[far][:1000].tolist()]
    assert len(elsewhere) == 1000
    assert counted(drive, elsewhere)[ClosureDecision.ACCEPTED] == 0
