"""Queries tracked as one drive: fixes, wrong segments, stops and kidnappings are counted."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.split import Every
from core.evaluation.tracks import cut_position
from core.parameters import MapParameters
from core.projection.imager import Views
from core.scans.drive import MemoryDrive
from core.scans.stands import stands_of
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor

pytestmark = pytest.mark.slow


@functools.cache
def scans():
    """Return the scans of a drive that stops before turns."""
    return list(SimulatedDrive(seed=2, scans=200, sensor=SimulatedSensor(firings=500)))


@functools.cache
def tracked(*, poses):
    drive = scans() if poses else [replace(scan, pose=None) for scan in scans()]
    protocol = EvaluationProtocol(
        MapParameters.for_sensor(views=Views.FULL), segments=4, split=Every(2), track=True
    )
    (found,) = evaluate(MemoryDrive("d", drive), protocol).tracks
    return found


def test_a_drive_that_was_mapped_is_followed_without_a_wrong_segment():
    found = tracked(poses=True)
    assert (found.observations, found.refusals) == (100, 0)
    assert found.first_fix is not None
    assert 3 <= found.first_fix <= 10
    assert found.localized >= 90
    assert found.localized + sum(found.not_localized.values()) == 100
    assert found.errors == ()
    assert (found.errors_moving, found.errors_stationary) == (0, 0)
    assert found.recall_at_1[3.0] == 1.0
    assert found.position_error_m_median is not None
    assert found.position_error_m_median < 1.0


def test_stops_are_found_and_the_place_is_held():
    found = tracked(poses=True)
    assert found.standing_found is not None
    assert found.standing_found > 0.8
    assert found.standing_false is not None
    assert found.standing_false < 0.1
    assert found.flicker == 0


def test_a_segment_that_was_cut_while_the_vehicle_stood_is_right_at_all_of_that_place():
    drive = MemoryDrive("d", scans())
    protocol = EvaluationProtocol(
        MapParameters.for_sensor(views=Views.FULL), segment_length=10, split=Every(2), track=True
    )
    stands = stands_of(drive.poses)
    assert ((stands[:, 0] // 10) < (stands[:, 1] // 10)).any()
    (found,) = evaluate(drive, protocol).tracks
    assert found.errors == ()
    assert found.segments_reported >= 65
    assert found.flicker == 0


@pytest.mark.parametrize("poses", [True, False])
def test_a_vehicle_that_was_moved_is_found_again_where_it_is(poses):
    recovery = tracked(poses=poses).recovery
    assert len(recovery) == 8
    assert all(scans is not None and 3 <= scans <= 12 for scans in recovery)
    assert tracked(poses=poses).recovery_text == str(max(filter(None, recovery)))
    lost = replace(tracked(poses=poses), recovery=(4, None, 6, None))
    assert lost.recovery_text == "6, 2 lost"
    assert replace(lost, recovery=()).recovery_text == "-"


def test_without_poses_nothing_is_said_of_stops_and_metres():
    found = tracked(poses=False)
    assert found.standing_found is found.standing_false is found.flicker is None
    assert found.errors_moving is found.errors_stationary is None
    assert found.recall_at_1[3.0] is found.position_error_m_median is None
    assert found.errors == ()
    assert found.as_dict()["errors"] == 0


def test_a_cut_between_scans_that_were_held_out_is_where_the_drive_was_cut():
    mapped = np.array([0, 2, 4, 6, 8])
    assert cut_position(mapped, np.array([0, 5, 9])).tolist() == [-0.5, 2.25, 4.5]
