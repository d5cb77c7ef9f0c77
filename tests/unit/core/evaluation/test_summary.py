"""The figures of answers: probabilities, errors of segments, and how the vehicle moved."""

import json
from dataclasses import replace

import numpy as np
import pytest

from core.evaluation.condition import Condition
from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.selected import SelectedScans
from core.parameters import MapParameters
from core.projection.imager import Views
from core.scans.drive import MemoryDrive
from core.simulation import SimulatedDrive
from tests.support.samples import SMALL_GRID, sample_drive

pytestmark = pytest.mark.slow

SMALL = MapParameters(grid=SMALL_GRID, ranks=(3, 3))


@pytest.fixture(scope="module")
def found_by_harmonics(drive, elsewhere):
    parameters = MapParameters.for_sensor(
        encoding="harmonic", lateral_renderings_m=(-2.0, 0.0, 2.0)
    )
    disturbed = (Condition(), Condition(yaw_deg=-120.0, lateral_m=2.0))
    protocol = EvaluationProtocol(parameters, segments=2, conditions=disturbed)
    return evaluate(drive, protocol, unknown=[elsewhere])


def test_the_harmonic_encoding_estimates_heading_and_offset_and_lists_its_parameters(
    found_by_harmonics,
):
    written = json.loads(json.dumps(found_by_harmonics.as_dict(), allow_nan=False))
    assert written["encoding"] == "harmonic"
    assert (written["image"], written["reducer"]) == ("height", "highest")
    assert written["distance"] == "normalised"
    assert written["lateral_renderings_m"] == [-2.0, 0.0, 2.0]
    for row in written["conditions"]:
        assert row["recall_at_1"]["3"] >= 0.9
        assert row["heading_error_deg_median"] <= 2.0
        assert row["lateral_error_m_median"] <= 0.75
        assert row["position_error_m_median"] <= 2.0


def test_unknown_places_are_queried_and_the_probabilities_checked(found_by_harmonics, elsewhere):
    found = found_by_harmonics
    assert found.calibrated
    assert found.unknown_drives == (elsewhere.name,)
    of_it = found.conditions[0].reliability
    assert of_it is not None
    assert of_it.unknown_queries == 20
    assert of_it.auroc is not None
    assert of_it.auroc > 0.9
    assert of_it.refused_unknown is not None
    written = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert written["conditions"][0]["reliability"]["auroc"] == of_it.auroc
    assert written["unknown_drives"] == [elsewhere.name]


@pytest.mark.parametrize(("first", "places", "calibrated"), [(60, 17, True), (300, 24, False)])
def test_a_map_is_calibrated_if_scans_have_probabilities(first, places, calibrated):
    """Of keyframes 9 m apart signatures and scans are not calibrated alike."""
    whole = SimulatedDrive(seed=11, scans=500, stops=False)
    mapped = SelectedScans(whole, first + 6 * np.arange(places))
    queries = SelectedScans(whole, first + 3 + 18 * np.arange(places // 3))
    found = evaluate(mapped, EvaluationProtocol(MapParameters.for_sensor()), queries)
    assert found.calibrated == calibrated
    assert (found.conditions[0].reliability is not None) == calibrated


def test_queries_off_the_map_are_of_no_known_place_and_counted_apart(drive, elsewhere):
    """A second pass, some of which is elsewhere: compare's AUROC leaves such queries out too."""
    parameters = MapParameters.for_sensor(
        encoding="harmonic", lateral_renderings_m=(0.0,), views=Views.FULL
    )
    protocol = EvaluationProtocol(parameters, segments=2)
    far = [
        replace(scan, pose=None if scan.pose is None else moved(scan.pose)) for scan in elsewhere
    ]
    mapped, partly = list(drive), MemoryDrive("partly", [*list(drive)[::3], *far])
    on_map = MemoryDrive("on the map", mapped[::3])
    found, of_map_alone = (
        evaluate(drive, protocol, queries, unknown=[elsewhere]).conditions[0].reliability
        for queries in (partly, on_map)
    )
    assert found is not None
    assert of_map_alone is not None
    assert (found.known_queries, found.off_map_queries) == (20, 20)
    assert (of_map_alone.known_queries, of_map_alone.off_map_queries) == (20, 0)
    assert replace(found, off_map_queries=0) == of_map_alone
    nothing_known = MemoryDrive("far", far)
    (row,) = evaluate(drive, protocol, nothing_known, unknown=[elsewhere]).conditions
    assert row.reliability is not None
    assert (row.reliability.known_queries, row.reliability.off_map_queries) == (0, 20)
    assert row.reliability.auroc is row.reliability.ece is row.reliability.refused_right is None
    assert row.reliability.refused_unknown == of_map_alone.refused_unknown


def moved(pose):
    return replace(pose, x_m=pose.x_m + 1e4)


def test_a_right_place_on_another_pass_is_an_error_of_the_same_place():
    """A street driven twice: scans of one pass that are held out are found on the other."""
    once = list(sample_drive(20))
    again = [replace(scan, timestamp_s=scan.timestamp_s + 2.0) for scan in once]
    twice, disturbed = MemoryDrive("twice", [*once, *again]), (Condition(), Condition(yaw_deg=90.0))
    protocol = EvaluationProtocol(SMALL, segment_length=17, conditions=disturbed)
    as_driven, turned = evaluate(twice, protocol).conditions
    found = {error.scan: error.matched_scan for error in as_driven.errors}
    assert found.items() >= {2: 22, 7: 27, 12: 32, 24: 4, 29: 9, 34: 14}.items()
    assert as_driven.errors_same_place == len(as_driven.errors)
    for result in (as_driven, turned):
        for error in result.errors:
            apart_m = abs(error.scan % 20 - error.matched_scan % 20)
            assert error.apart_m == pytest.approx(apart_m)
        near = sum((error.apart_m or 0.0) <= 3.0 for error in result.errors)
        assert result.errors_same_place == result.as_dict()["errors_same_place"] == near
    assert (turned.errors_same_place or 0) < len(turned.errors)


def test_without_poses_no_error_is_known_to_be_of_the_same_place():
    found = evaluate(sample_drive(40, poses=False), EvaluationProtocol(SMALL, segments=4))
    (result,) = found.conditions
    assert result.errors
    assert result.errors_same_place is None
    assert all(error.apart_m is None for error in result.errors)


def test_queries_that_were_thinned_move_as_the_whole_drive_did():
    """Every tenth metre queries: between two of them the vehicle went 10 m, and stopped at one."""
    drive = sample_drive(60, name="second")
    poses = drive.poses.copy()
    poses[31:, 0] -= 1.0  # scans 30 and 31 were recorded at one place
    drive.poses = poses
    thinned = SelectedScans(drive, np.arange(1, 60)).apart(10.0)
    assert thinned.scans.tolist() == [1, 11, 21, 32, 42, 52]
    gaps = SelectedScans(drive, np.array([1, 11, 31, 59]), planar=True)
    found, with_gaps = (
        evaluate(sample_drive(60), EvaluationProtocol(SMALL, segments=4), queries)
        for queries in (thinned, gaps)
    )
    assert (found.standing_scans, with_gaps.standing_scans) == (0, 1)
    assert found.motion_surrogate_median_moving == pytest.approx(1.0)
    assert with_gaps.motion_surrogate_median_standing == 0.0
    for error in with_gaps.conditions[0].errors:
        assert error.motion_surrogate == pytest.approx(0.0 if error.scan == 31 else 1.0)
