"""Tracking on a recorded drive: no wrong segment is reported, stationary or moving."""

import pytest

from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.split import Interleaved
from core.parameters import MapParameters
from tests.support.recorded_drives import Drives

pytestmark = pytest.mark.real_data


@pytest.mark.parametrize(("segment_length", "phase"), [(50, 1), (50, 2), (100, 3), (167, 1)])
def test_no_wrong_segment_is_reported(drives: Drives, segment_length: int, phase: int) -> None:
    protocol = EvaluationProtocol(
        MapParameters.for_sensor(encoding="harmonic"),
        segment_length=segment_length,
        split=Interleaved(0.2, phase),
        track=True,
    )
    [found] = evaluate(drives.open("kit_muehlburger"), protocol).tracks
    assert found.errors == ()
    assert found.first_fix is not None
    assert found.first_fix <= 5
    assert found.localized >= found.observations - 6
    assert found.segments_told >= 0.88 * found.observations
    assert found.flicker == 0
    assert found.recall_at_1[3.0] == 1.0
    assert found.standing_found is not None
    assert found.standing_found >= 0.8
