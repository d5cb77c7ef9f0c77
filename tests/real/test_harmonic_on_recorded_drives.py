"""The harmonic encoding on recorded drives, with the bars that the method must keep."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from core.encodings.signature import pack_signatures, unpack_signatures
from core.evaluation.condition import Condition, conditions
from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.split import Every
from core.evaluation.summary import ConditionResult
from core.localization.localizer import Localizer
from core.mapping.fit import fit_map
from core.parameters import MapParameters
from core.projection.images import project_drive
from core.scans.trajectory import Trajectory
from tests.support.recorded_drives import Drives

pytestmark = pytest.mark.real_data

TURNED = conditions((0, 10, 90, 180), (0,), (0,))
BESIDE = (
    *conditions((0,), (1, -1, 2, -2, 2.25, -2.25, 3, -3), (0,)),
    *conditions((180,), (3, -3), (0,)),
)
NOISY = conditions((0,), (0,), (0.5, 1.0))
DEFAULT = MapParameters.for_sensor(encoding="harmonic")


one_worker = pytest.mark.xdist_group("found")


@pytest.fixture(scope="module")
def found(drives: Drives) -> dict[Condition, ConditionResult]:
    """One setting, the default, for every row."""
    protocol = EvaluationProtocol(DEFAULT, split=Every(2), conditions=(*TURNED, *BESIDE, *NOISY))
    rendered = drives.rendered("kitti00", DEFAULT)
    result = evaluate(drives.open("kitti00"), protocol, rendered=rendered)
    return {row.condition: row for row in result.conditions}


@one_worker
@pytest.mark.parametrize("condition", [*TURNED, *BESIDE, *NOISY], ids=str)
def test_a_place_is_recalled_whatever_the_heading_lane_and_noise(
    found: dict[Condition, ConditionResult], condition: Condition
) -> None:
    row = found[condition]
    assert (row.queries, row.refusals) == (125, 0)
    recall = row.recall_at_1[3.0]
    assert recall is not None
    assert recall >= (0.95 if condition.noise_m == 1.0 else 0.98)
    assert row.heading_error_deg_median is not None
    assert row.heading_error_deg_median <= 2.0


@one_worker
@pytest.mark.parametrize("condition", BESIDE, ids=str)
def test_the_answer_contains_the_lateral_offset_of_the_vehicle(
    found: dict[Condition, ConditionResult], condition: Condition
) -> None:
    error_m = found[condition].lateral_error_m_median
    assert error_m is not None
    assert error_m <= 0.75


def test_a_signature_of_99_bytes_loses_next_to_nothing(drives: Drives) -> None:
    drive = drives.open("kitti00")
    mapped = np.arange(0, len(drive), 2)
    rendered = drives.rendered("kitti00", DEFAULT)
    images = project_drive(drive, mapped, DEFAULT.imager, most_probes=0, rendered=rendered).images
    trajectory = Trajectory.of_drive("d", drive.timestamp_s[mapped], drive.poses[mapped], mapped)
    localizer = Localizer(fit_map(images, trajectory, np.array([0, len(mapped)]), DEFAULT))
    hits = {"whole": 0, "packed": 0}
    for index in range(1, len(drive), 2):
        for lateral_m in (0.0, 2.25):
            scan = Condition(lateral_m=lateral_m).apply(drive.scan(index), np.random.default_rng(0))
            signatures = localizer.basis.encode(localizer.basis.image(scan))
            body = pack_signatures(signatures)
            assert len(body) <= 99
            for name, sent in (("whole", signatures), ("packed", unpack_signatures(body))):
                row = localizer.localize_signatures(sent).best.row
                there = localizer.map.trajectory.poses[row, :3]
                hits[name] += bool(np.linalg.norm(there - drive.poses[index, :3]) <= 3.0)
    assert hits["packed"] >= hits["whole"] - 0.005 * 250


def test_evaluate_writes_what_it_found(drives: Drives, tmp_path: Path) -> None:
    out = tmp_path / "figures.json"
    command = [sys.executable, "-m", "app.cli", "evaluate", str(drives.path("kitti_drive0001"))]
    options = ["--encoding", "harmonic", "--split", "every:2", "--segments", "3"]
    chosen = ["--reducer", "highest", "--distance", "plain", "--lateral-renderings=-2,0,2"]
    disturbed = ["--yaw-deg=-45", "--lateral-m=0,-2", "--json", str(out)]
    root = Path(__file__).parents[2]
    subprocess.run(
        [*command, *options, *chosen, *disturbed], check=True, cwd=root, capture_output=True
    )
    written = json.loads(out.read_text())
    assert (written["encoding"], written["image"], written["reducer"]) == (
        "harmonic",
        "height",
        "highest",
    )
    assert written["distance"] == "plain"
    assert written["lateral_renderings_m"] == [-2.0, 0.0, 2.0]
    for row in written["conditions"]:
        assert row["recall_at_1"]["3"] >= 0.9
        assert row["heading_error_deg_median"] <= 3.0
        assert row["lateral_error_m_median"] <= 0.75
