"""An evaluation from a drive to its figures."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from core.encodings.registry import encoding_names
from core.errors import Cancelled, EmptyDrive, InvalidParameters
from core.evaluation.condition import Condition
from core.evaluation.evaluate import EvaluationProtocol, _nearest_beside, evaluate
from core.evaluation.motion import is_standing
from core.evaluation.split import Every, Interleaved
from core.odometry.posed_drive import PosedDrive
from core.parameters import MapParameters, Segmentation
from core.projection.imager import Imager
from core.projection.images import project_drive
from core.scans.accumulation import AccumulatedDrive
from core.scans.drive import MemoryDrive
from tests.support.samples import (
    SMALL_GRID,
    FaultyDrive,
    RecordedProgress,
    sample_drive,
    straight_poses,
)

pytestmark = pytest.mark.slow

SMALL = MapParameters(grid=SMALL_GRID, ranks=(3, 3))


@pytest.fixture(scope="module")
def found(drive):
    disturbed = (Condition(), Condition(yaw_deg=180.0), Condition(noise_m=2.0))
    return evaluate(drive, EvaluationProtocol(segments=4, conditions=disturbed))


def test_the_protocol_is_the_papers_by_default():
    assert EvaluationProtocol().split == Interleaved(0.2)
    assert EvaluationProtocol().parameters.ranks == (5, 5)
    assert EvaluationProtocol().conditions == (Condition(),)


def test_the_figures_add_up(found, drive):
    assert found.segments == 4
    assert (found.map_scans, found.conditions[0].queries) == (48, 12)
    assert len(found.relative_error) == 4
    assert found.compression.tensor_ratio == pytest.approx(
        48 * 30 * 361 / (4 * 5 * (30 + 361) + 48 * 25)
    )
    stationary = is_standing(drive.poses, drive.timestamp_s)
    assert found.standing_scans == stationary[np.arange(60) % 15 % 5 == 2].sum()
    for result in found.conditions:
        assert result.refusals == 0
        assert result.errors_moving + result.errors_stationary == len(result.errors)
        assert result.segment_accuracy == pytest.approx(1 - len(result.errors) / 12)
        assert list(result.recall_at_1) == [3.0, 5.0, 10.0]
        recalls = list(result.recall_at_1.values())
        assert recalls == sorted(recalls)
        assert 0 < result.ms_per_query <= result.ms_slowest
        for error in result.errors:
            assert error.segment == error.scan // 15 != error.matched_segment
            assert error.matched_scan // 15 == error.matched_segment
            assert error.standing == stationary[error.scan]
            assert error.motion_surrogate >= 0


def test_a_neighbour_is_found_as_driven_and_not_at_180_degrees(found):
    as_driven, at_180_deg, _ = found.conditions
    assert as_driven.recall_at_1[3.0] > 0.9
    assert as_driven.position_error_m_median < 3.0
    assert at_180_deg.segment_accuracy < as_driven.segment_accuracy


def test_an_evaluation_is_plain_json(found):
    text = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert text["split"] == "interleaved:0.2"
    assert list(text["conditions"][0]["recall_at_1"]) == ["3", "5", "10"]
    assert text["conditions"][1]["yaw_deg"] == 180.0
    assert text["conditions"][1]["errors"] == len(text["conditions"][1]["error_scans"])


def test_the_time_of_a_query_is_the_median_which_one_slow_first_query_does_not_change(monkeypatch):
    steps = iter([0.0, 9.0, *(s for i in range(7) for s in (10.0 + i, 10.25 + i))])
    monkeypatch.setattr(
        "core.evaluation.evaluate.time", SimpleNamespace(perf_counter=steps.__next__)
    )
    (result,) = evaluate(sample_drive(40), EvaluationProtocol(SMALL, segments=4)).conditions
    assert (result.ms_per_query, result.ms_slowest) == (250.0, 9000.0)


def without_times(result):
    return {name: value for name, value in result.as_dict().items() if name[:3] != "ms_"}


def test_a_conditions_figures_do_not_depend_on_other_conditions(drive, found):
    alone = evaluate(drive, EvaluationProtocol(segments=4, conditions=(Condition(noise_m=2.0),)))
    assert without_times(alone.conditions[0]) == without_times(found.conditions[2])


def test_another_seed_is_other_noise():
    noisy = (Condition(noise_m=20.0),)
    drive = sample_drive(60)
    one, same, other = (
        evaluate(
            drive, EvaluationProtocol(SMALL, segments=3, conditions=noisy, seed=seed)
        ).conditions[0]
        for seed in (0, 0, 1)
    )
    assert without_times(one) == without_times(same)
    assert without_times(one) != without_times(other)


def test_a_drive_without_poses_has_no_figures_in_metres():
    found = evaluate(sample_drive(40, poses=False), EvaluationProtocol(SMALL, segments=4))
    (result,) = found.conditions
    assert found.standing_scans is None
    assert result.segment_accuracy is not None
    assert result.errors
    assert result.errors_moving is result.errors_stationary is None
    assert result.recall_at_1 == {3.0: None, 5.0: None, 10.0: None}
    assert result.position_error_m_median is None
    assert all(e.standing is e.motion_surrogate is None for e in result.errors)
    json.dumps(found.as_dict(), allow_nan=False)


def test_scans_that_cannot_be_used_are_skipped_in_the_map_and_rejected_as_queries():
    drive = FaultyDrive(sample_drive(40), {2, 3, 7, 11})  # 2 and 7 are queries, j mod 5 == 2
    found = evaluate(drive, EvaluationProtocol(SMALL, segments=4))
    assert [item.scan for item in found.skipped] == [3, 11]
    assert found.map_scans == 30
    assert (found.conditions[0].queries, found.conditions[0].refusals) == (8, 2)
    numbered = AccumulatedDrive(FaultyDrive(sample_drive(40), {3}), 2)
    found = evaluate(numbered, EvaluationProtocol(SMALL, segments=2))
    assert [item.scan for item in found.skipped] == [3]  # the second of the drive


def test_queries_that_a_condition_leaves_without_returns_are_rejected():
    far = (Condition(), Condition(lateral_m=1e39))
    found = evaluate(sample_drive(40), EvaluationProtocol(SMALL, segments=4, conditions=far))
    assert [result.refusals for result in found.conditions] == [0, 8]
    nothing = found.conditions[1]
    assert nothing.segment_accuracy is nothing.ms_per_query is nothing.ms_slowest is None
    assert nothing.position_error_m_median is None
    assert nothing.recall_at_1[3.0] is None
    json.dumps(found.as_dict(), allow_nan=False)


def test_a_second_drive_queries_the_whole_of_the_first():
    drive = sample_drive(40)
    found = evaluate(drive, EvaluationProtocol(SMALL, segments=4), sample_drive(30, name="second"))
    (result,) = found.conditions
    assert (found.drive, found.query_drive, found.split) == ("drive", "second", None)
    assert (found.map_scans, result.queries) == (40, 30)
    # The same scans at the same places: each finds itself, and its segment is the nearest scan's.
    assert result.segment_accuracy == 1.0
    assert result.position_error_m_median == 0.0
    assert result.recall_at_1[3.0] == 1.0


def test_a_querys_true_segment_is_that_of_the_nearest_map_scan():
    drive, other = sample_drive(40), sample_drive(40, seed=1, name="second")
    (result,) = evaluate(drive, EvaluationProtocol(SMALL, segments=4), other).conditions
    assert result.errors
    assert all(error.segment == error.scan // 10 for error in result.errors)


def test_queries_off_the_map_have_no_true_segment_and_no_recall_counts_them():
    """Scans 30 to 59 of a street query a map of its scans 0 to 39, as `compare` counts them."""
    street = list(sample_drive(60))
    first, second = MemoryDrive("a", street[:40]), MemoryDrive("b", street[30:])
    protocol = EvaluationProtocol(SMALL, segments=4, tolerances_m=(3.0, 5.0))
    (result,) = evaluate(first, protocol, second).conditions
    assert result.findable == {3.0: 13, 5.0: 15}
    assert result.recall_at_1 == {3.0: pytest.approx(10 / 13), 5.0: pytest.approx(10 / 15)}
    # Ten are scans of the map and find themselves. The next five are near its last segment.
    assert {error.scan for error in result.errors} <= set(range(10, 15))
    assert result.segment_accuracy == pytest.approx(1 - len(result.errors) / 15)
    assert result.as_dict()["findable"] == {"3": 13, "5": 15}


def test_without_a_findable_query_there_is_no_recall():
    drive = sample_drive(10, name="far")
    far = PosedDrive(drive, drive.poses + np.array([1e4, 0, 0, 0, 0, 0, 0]))
    protocol = EvaluationProtocol(SMALL, segments=2, track=True)
    found = evaluate(sample_drive(20), protocol, far)
    (result,), (tracked,) = found.conditions, found.tracks
    assert result.findable == tracked.findable == {3.0: 0, 5.0: 0, 10.0: 0}
    assert result.recall_at_1 == tracked.recall_at_1 == {3.0: None, 5.0: None, 10.0: None}
    assert result.segment_accuracy is None


def test_a_second_drive_without_poses_has_no_accuracy():
    drive, other = sample_drive(40), sample_drive(10, poses=False)
    (result,) = evaluate(drive, EvaluationProtocol(SMALL, segments=4), other).conditions
    assert result.segment_accuracy is None
    assert result.errors == ()
    assert result.errors_moving is result.errors_stationary is None
    assert result.as_dict()["errors"] is None
    assert result.refusals == 0


def test_a_split_that_empties_a_segment_is_rejected():
    with pytest.raises(InvalidParameters, match="segment 1 is left without a map scan"):
        evaluate(sample_drive(6), EvaluationProtocol(SMALL, segment_length=1, split=Every(2)))


def test_a_split_that_holds_nothing_out_is_rejected_before_the_work():
    progress = RecordedProgress()
    with pytest.raises(InvalidParameters, match="some must be queried"):
        evaluate(
            sample_drive(6), EvaluationProtocol(SMALL, split=Interleaved(0.01)), progress=progress
        )
    assert progress.stages == []


def test_segments_too_short_for_the_split_are_rejected_with_what_is_wanted():
    wanted = "0 of 40 scans out, of 40 segments .* of 3 scans or more, at most 13 of them"
    with pytest.raises(InvalidParameters, match=wanted):
        evaluate(sample_drive(40), EvaluationProtocol(SMALL, segments=40))
    wanted = "40 of 40 scans out, of 20 segments with up to 2 scans: .* of 3 scans or more"
    with pytest.raises(InvalidParameters, match=wanted):
        evaluate(sample_drive(40), EvaluationProtocol(SMALL, segments=20, split=Interleaved(0.8)))
    evaluate(sample_drive(40), EvaluationProtocol(SMALL, segments=13))


def test_queries_without_a_pose_leave_the_others_split_into_moving_and_standing():
    drive = sample_drive(40)
    poses = drive.poses.copy()
    poses[[12, 22]] = np.nan
    poses[[17, 32]] = poses[[16, 31]]
    drive.poses = poses
    found = evaluate(drive, EvaluationProtocol(SMALL))
    assert found.standing_scans == 2
    assert found.motion_surrogate_median_standing == 0.0
    assert (found.motion_surrogate_median_moving or 0.0) > 0.0


def test_an_empty_drive_is_rejected():
    empty = MemoryDrive("empty", [])
    with pytest.raises(EmptyDrive, match="drive empty has no scan"):
        evaluate(empty, EvaluationProtocol(SMALL))
    with pytest.raises(EmptyDrive, match="drive empty has no scan"):
        evaluate(sample_drive(6), EvaluationProtocol(SMALL), empty)


def test_progress_receives_every_stage_and_can_stop_it():
    progress = RecordedProgress()
    drive = FaultyDrive(sample_drive(40), {2, 3})
    two = (Condition(), Condition(yaw_deg=10.0))
    evaluate(drive, EvaluationProtocol(SMALL, segments=4, conditions=two), progress=progress)
    assert progress.stages == [
        ("projecting", 32),
        ("fitting", 62),
        ("calibrating", 31),
        ("localizing", 16),
    ]
    assert progress.done == [32, 62, 31, 16]

    class Stop(RecordedProgress):
        def start(self, stage, total):
            if stage == "localizing":
                raise Cancelled("enough")

        def advance(self, units=1):
            pass

    with pytest.raises(Cancelled):
        evaluate(sample_drive(40), EvaluationProtocol(SMALL), progress=Stop())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"tolerances_m": ()}, "tolerances_m"),
        ({"tolerances_m": (0.0,)}, "tolerances_m"),
        ({"tolerances_m": (3.0, np.nan)}, "tolerances_m"),
        ({"tolerances_m": (np.inf,)}, "tolerances_m"),
        ({"seed": -1}, "seed is -1"),
        ({"conditions": ()}, "conditions"),
    ],
)
def test_an_invalid_protocol_is_rejected(wrong, message):
    with pytest.raises(InvalidParameters, match=message):
        EvaluationProtocol(**wrong)


def test_the_papers_encoding_estimates_neither(found):
    assert (found.image, found.distance, found.lateral_renderings_m) == ("range", None, None)
    for row in found.conditions:
        assert (row.heading_error_deg_median, row.lateral_error_m_median) == (None, None)


def test_without_poses_no_probability_is_checked(drive):
    blind = MemoryDrive(drive.name, [replace(scan, pose=None) for scan in drive])
    found = evaluate(blind, EvaluationProtocol(segments=4))
    assert found.conditions[0].reliability is None


def test_an_unknown_drive_without_a_scan_is_rejected(drive):
    with pytest.raises(EmptyDrive):
        evaluate(drive, EvaluationProtocol(segments=4), unknown=[MemoryDrive("none", [])])


@pytest.mark.parametrize("encoding", encoding_names())
def test_unequal_segments_are_cut_over_all_scans_and_reported(encoding):
    parameters = MapParameters.for_sensor(
        encoding=encoding, ranks=(2, 2), segmentation=Segmentation.UNEQUAL
    )
    found = evaluate(sample_drive(40), EvaluationProtocol(parameters, segments=4))
    assert found.as_dict()["segmentation"] == "unequal"
    assert found.segments >= 2
    assert found.map_scans == 32
    assert len(found.conditions[0].errors) <= 8


def test_each_scan_is_rendered_once_for_unequal_segments_and_their_map(monkeypatch):
    rendered = []
    render = Imager.render

    def counted(imager, scan):
        rendered.append(scan)
        return render(imager, scan)

    monkeypatch.setattr(Imager, "render", counted)
    parameters = MapParameters(ranks=(2, 2), segmentation=Segmentation.UNEQUAL)
    evaluate(sample_drive(40), EvaluationProtocol(parameters, segments=4, split=Every(2)))
    assert len(rendered) == 40


@pytest.mark.parametrize("segmentation", Segmentation)
def test_scans_that_were_rendered_before_are_not_rendered_again(monkeypatch, segmentation):
    drive = sample_drive(40)
    parameters = MapParameters(ranks=(2, 2), segmentation=segmentation)
    protocol = EvaluationProtocol(parameters, segments=4, split=Every(2))
    expected = evaluate(drive, protocol)
    rendered = project_drive(drive, np.arange(len(drive)), parameters.imager, most_probes=0)
    monkeypatch.delattr(Imager, "render")
    found = evaluate(drive, protocol, rendered=rendered)
    assert found.relative_error == expected.relative_error
    assert found.conditions[0].recall_at_1 == expected.conditions[0].recall_at_1


def test_a_scan_that_cannot_be_used_is_in_no_unequal_segments_model():
    parameters = MapParameters(ranks=(2, 2), segmentation=Segmentation.UNEQUAL)
    drive = FaultyDrive(sample_drive(40), {0, 17, 39})
    found = evaluate(drive, EvaluationProtocol(parameters, segments=4, split=Every(2)))
    assert found.map_scans + found.conditions[0].queries == 39
    assert [skipped.scan for skipped in found.skipped] == [0]


def test_a_held_out_scan_is_of_a_stand_if_a_mapped_scan_beside_it_is_of_its_place():
    poses = straight_poses(60)
    poses[10:40, 0] = 10.0
    poses[9, 0] = 9.7  # braking: of the map's stand, not of one of its own
    poses[20, :3] = np.nan
    scans = np.arange(1, 60, 2)
    mapped = np.arange(0, 60, 2)
    rows = dict(zip(scans.tolist(), _nearest_beside(poses, scans, mapped).tolist(), strict=True))
    assert rows[9] == 5
    assert [rows[scan] for scan in (11, 19, 21, 39)] == [5, 9, 11, 19]
    assert {rows[scan] for scan in (1, 7, 41, 59)} == {-1}
