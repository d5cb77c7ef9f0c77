"""Other methods on a recorded drive: Scan Context is what others measured it to be."""

import numpy as np
import pytest

from baselines.m2dp import M2dp
from baselines.scan_context import ScanContext
from baselines.solid import Solid
from core.evaluation.compare import ComparisonProtocol, MethodUnderCondition, compare
from core.evaluation.condition import Condition, conditions
from core.evaluation.pairing import HeldOut
from core.evaluation.split import Every
from tests.support.recorded_drives import Drives

pytestmark = pytest.mark.real_data

DRIVEN, TURNED, LEFT, RIGHT, NOISY = CONDITIONS = (
    *conditions((0, 90), (0,), (0,)),
    Condition(yaw_deg=180.0, lateral_m=3.0),
    Condition(yaw_deg=180.0, lateral_m=-3.0),
    Condition(noise_m=1.0),
)


one_worker = pytest.mark.xdist_group("scan_context")


@pytest.fixture(scope="module")
def scan_context(drives: Drives) -> dict[Condition, MethodUnderCondition]:
    protocol = ComparisonProtocol(HeldOut(Every(2)), conditions=CONDITIONS)
    [method] = compare(drives.open("kitti00"), [ScanContext()], protocol).methods
    assert method.sent_bytes == 4800
    return {row.condition: row for row in method.conditions}


@one_worker
@pytest.mark.parametrize(
    ("condition", "recall"),
    [(DRIVEN, 1.00), (TURNED, 1.00), (LEFT, 0.21), (RIGHT, 0.35), (NOISY, 0.97)],
    ids=str,
)
def test_scan_context_is_as_good_as_it_was_measured(
    scan_context: dict[Condition, MethodUnderCondition], condition: Condition, recall: float
) -> None:
    """The figures are those that the prototype of the method measured independently."""
    row = scan_context[condition]
    assert row.findable == {3.0: 125, 5.0: 125, 10.0: 125}
    assert row.recall_at_1[3.0] == pytest.approx(recall, abs=0.02)


@one_worker
def test_scan_context_finds_the_relative_yaw_to_half_a_sector(
    scan_context: dict[Condition, MethodUnderCondition],
) -> None:
    for condition in (DRIVEN, TURNED):
        error_deg = scan_context[condition].heading_error_deg_median
        assert error_deg is not None
        assert error_deg <= 3.0


def test_the_other_baselines_find_most_places_and_reject_another_drive(drives: Drives) -> None:
    others = [Solid(), M2dp()]
    protocol = ComparisonProtocol(HeldOut(Every(2)), tolerances_m=(5.0,), unknown_every=25)
    result = compare(
        drives.open("kitti00"), others, protocol, unknown_drive=drives.open("kit_muehlburger")
    )
    for method in result.methods:
        [row] = method.conditions
        assert row.queries == 125
        recall, known = row.recall_at_1[5.0], row.novelty_auroc
        assert recall is not None
        assert known is not None
        assert recall >= 0.65
        assert known >= 0.8
        assert np.isfinite([row.max_f1[5.0] or np.nan, row.average_precision[5.0] or np.nan]).all()
