"""The report on a recorded drive: its sweep agrees with `tensormap evaluate`."""

import pytest

from app.provenance import of_report
from app.report.page import render_report
from core.encodings.registry import encoding_names
from core.evaluation.advisor import AdviceDecision
from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.study import Study
from core.evaluation.study_drive import StudyProtocol, study_drive
from core.parameters import MapParameters
from tests.support.recorded_drives import Drives

pytestmark = [pytest.mark.real_data, pytest.mark.xdist_group("study")]

FEW = {
    "r1": (2, 5, 8),
    "r2": (2, 5, 8),
    "segment_lengths": (50, 125),
    "noise_m": (0.0, 0.5),
    "lateral_m": (0.0,),
    "yaw_deg": (0.0, 90.0),
}


@pytest.fixture(scope="module")
def study(drives: Drives) -> Study:
    parameters = tuple(MapParameters.for_sensor(encoding=encoding) for encoding in encoding_names())
    return study_drive(drives.open("kitti00"), StudyProtocol(parameters, **FEW))  # type: ignore[arg-type]


def test_the_sweep_agrees_with_evaluate(study: Study, drives: Drives) -> None:
    protocol = EvaluationProtocol(MapParameters.for_sensor(encoding="paper"), segment_length=50)
    expected = evaluate(drives.open("kitti00"), protocol)
    found = study.encodings[0].sweep.at((5, 5), 50)
    assert found is not None
    row = expected.conditions[0]
    assert found.segment_accuracy == row.segment_accuracy
    assert found.accuracy[0] == row.recall_at_1[3.0]
    assert found.elements == expected.compression.elements


def test_the_advice_is_decided_and_reports_the_effect_of_yaw_and_noise(study: Study) -> None:
    paper, harmonic = study.encodings
    for of in (paper, harmonic):
        assert of.advice.decision == AdviceDecision.DECIDED
        assert of.advice.recommended is not None
        assert of.advice.recommended.ranks != (2, 2)
    assert harmonic.curve("yaw_deg")[-1].right >= 0.95 * harmonic.sweep.counted
    assert paper.curve("yaw_deg")[-1].right <= 0.2 * paper.sweep.counted


def test_the_page_shows_the_driven_line(study: Study) -> None:
    page = render_report(study, of_report())
    assert "250 scans, 443 m" in page
    assert 'id="nodes"' in page
    assert "176 m by 270 m" in page
