"""Known places are separated from unknown ones on recorded drives."""

import pytest

from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.split import Every
from core.parameters import MapParameters
from tests.support.recorded_drives import Drives

pytestmark = pytest.mark.real_data


def test_scans_of_another_town_are_separated_from_those_of_the_map(drives: Drives) -> None:
    parameters = MapParameters.for_sensor(encoding="harmonic")
    found = evaluate(
        drives.open("kitti00"),
        EvaluationProtocol(parameters, segments=5, split=Every(2)),
        unknown=[drives.open("kit_muehlburger")],
    )
    of_it = found.conditions[0].reliability
    assert of_it is not None
    assert of_it.unknown_queries == 501
    assert of_it.auroc is not None
    assert of_it.auroc >= 0.98
    assert of_it.refused_right is not None
    assert of_it.refused_right <= 0.05
    assert of_it.refused_unknown is not None
    assert of_it.refused_unknown >= 0.95
