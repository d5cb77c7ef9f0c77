"""Turns, unequal segments and the graph of recorded drives."""

import numpy as np
import pytest

from core.encodings.registry import encoding_names
from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.split import Every
from core.parameters import MapParameters, Segmentation
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import cut_drives
from core.segmentation.turns import cut_at_turns, turns
from core.topology import cut_at_meetings, join_segments
from tests.support.recorded_drives import Drives

pytestmark = pytest.mark.real_data


def of_drive(drives: Drives, name: str) -> Trajectory:
    drive = drives.open(name)
    return Trajectory.of_drive(name, drive.timestamp_s, drive.poses, np.arange(len(drive)))


def test_kitti00_turns_four_times_and_the_others_never(drives: Drives) -> None:
    # Headings change by some 90 degrees at scans 45, 80, 165 and 212.
    assert np.abs(turns(of_drive(drives, "kitti00")) - [45, 80, 165, 212]).max() <= 6
    mapped = of_drive(drives, "kitti00")
    cuts = cut_at_turns(mapped, cut_drives(mapped.drive_start, 760))
    assert cuts.tolist() == [0, *turns(mapped), len(mapped)]
    assert not len(turns(of_drive(drives, "kitti_drive0001")))
    assert not len(turns(of_drive(drives, "kit_muehlburger")))


@pytest.mark.parametrize("name", ["kitti00", "kitti_drive0001", "kit_muehlburger"])
def test_no_recorded_drive_comes_by_twice_and_none_is_joined(drives: Drives, name: str) -> None:
    mapped = of_drive(drives, name)
    cuts = cut_drives(mapped.drive_start, 25)
    assert cut_at_meetings(mapped, cuts).tolist() == cuts.tolist()
    assert join_segments(mapped, cuts).is_plain


@pytest.mark.parametrize("name", ["kitti00", "kit_muehlburger"])
def test_a_recorded_drive_driven_back_beside_itself_adds_no_edge(drives: Drives, name: str) -> None:
    alone = of_drive(drives, name)
    beside = alone.poses[::-1].copy()
    rng = np.random.default_rng(0)
    beside[:, :2] += np.array([1.5, -1.0]) + rng.normal(scale=0.05, size=(len(beside), 2))
    back = Trajectory.of_drive("back", alone.timestamp_s, beside, np.arange(len(beside)))
    both = Trajectory.concatenate([alone, back])
    once = join_segments(alone, cut_drives(alone.drive_start, 50))
    found = join_segments(both, cut_at_meetings(both, cut_drives(both.drive_start, 50)))
    # Of kit_muehlburger's first 188 scans, taken while stationary, the graph of one drive has
    # segments that the vehicle does not come by again.
    assert found.edges <= once.edges + 1
    assert np.isclose(found.edge_length_m.sum(), once.edge_length_m.sum(), rtol=0.03)


@pytest.mark.parametrize("name", ["kitti00", "kit_muehlburger"])
@pytest.mark.parametrize("encoding", encoding_names())
def test_unequal_segments_keep_to_equal_storage_and_recall_as_much(
    drives: Drives, name: str, encoding: str
) -> None:
    unequal = MapParameters.for_sensor(encoding=encoding, segmentation=Segmentation.UNEQUAL)
    split = Every(2)  # the same scans whatever the cuts
    drive = drives.open(name)
    rendered = drives.rendered(name, unequal)
    protocol = EvaluationProtocol(unequal, segments=5, split=split)
    found = evaluate(drive, protocol, rendered=rendered)
    fixed = MapParameters.for_sensor(encoding=encoding)
    protocol = EvaluationProtocol(fixed, segments=found.segments, split=split)
    equal = evaluate(drive, protocol, rendered=rendered)
    assert found.compression.elements == equal.compression.elements
    recall, of_equal = (one.conditions[0].recall_at_1[3.0] for one in (found, equal))
    assert recall is not None
    assert of_equal is not None
    assert recall >= of_equal - (0.03 if encoding == "paper" else 0.0)
