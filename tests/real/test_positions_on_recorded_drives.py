"""Positions between the scans of recorded drives: docs/reference/position-measurements.md."""

import pytest

from core.evaluation.condition import Condition
from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.split import Every
from core.parameters import MapParameters
from core.projection.imager import Views
from tests.support.recorded_drives import Drives

pytestmark = pytest.mark.real_data

BESIDE = (
    Condition(),
    *(Condition(lateral_m=left_m) for left_m in (2.0, 3.0, 5.0)),
    Condition(lateral_m=4.0, yaw_deg=180.0),
)
SPARSE = Condition(disturb="beams:vlp-16")
MADE = [(Views.FULL, (5, 5)), (Views.ANY, (5, 5)), (Views.ANY, (5, 8))]


@pytest.mark.parametrize(("views", "ranks"), MADE)
def test_half_of_the_positions_between_scans_are_within_a_metre(
    drives: Drives, views: Views, ranks: tuple[int, int]
) -> None:
    parameters = MapParameters.for_sensor(views=views, ranks=ranks)
    protocol = EvaluationProtocol(parameters, split=Every(2), conditions=(*BESIDE, SPARSE))
    rendered = drives.rendered("kitti00", parameters)
    for row in evaluate(drives.open("kitti00"), protocol, rendered=rendered).conditions:
        assert row.position_error_m_median is not None
        assert row.position_error_m_median <= 1.0, row.condition


@pytest.mark.parametrize(("views", "ranks"), MADE)
def test_positions_at_thirds_err_by_two_fifths_less_than_the_nearest_scans(
    drives: Drives, views: Views, ranks: tuple[int, int]
) -> None:
    parameters = MapParameters.for_sensor(views=views, ranks=ranks)
    protocol = EvaluationProtocol(parameters, split=Every(3), conditions=BESIDE)
    rendered = drives.rendered("kitti00", parameters)
    for row in evaluate(drives.open("kitti00"), protocol, rendered=rendered).conditions:
        assert row.position_error_m_median is not None
        assert row.nearest_scan_m_median is not None
        assert row.position_error_m_median <= 0.6 * row.nearest_scan_m_median, row.condition
