import numpy as np
import pytest

from core.evaluation.truth import left_out_notes, truth_notes
from core.odometry.posed_drive import PosedDrive
from core.scans.drive import MemoryDrive
from tests.support.recording import recording

MONDAY = MemoryDrive("monday", recording(scans=8).scans)
TUESDAY = MemoryDrive("tuesday", recording(scans=8).scans)
POSES = TUESDAY.poses


def unposed(drive):
    return PosedDrive(drive, np.full((8, 7), np.nan))


def test_drives_with_poses_in_one_world_need_no_note():
    assert list(truth_notes(MONDAY, None, 10.0)) == []
    assert list(truth_notes(MONDAY, TUESDAY, 10.0)) == []


def test_queries_of_places_that_are_not_mapped_are_noted():
    poses = POSES + np.array([5e5, 5e6, 0, 0, 0, 0, 0])
    poses[3] = POSES[3]
    poses[4, :3] = np.nan  # it may have a place
    assert list(truth_notes(MONDAY, PosedDrive(TUESDAY, poses), 10.0)) == [
        "6 of 7 queries of tuesday have no place within 10 m in monday: no recall counts them"
    ]


def test_poses_in_another_world_frame_are_noted():
    poses = POSES + np.array([5e5, 5e6, 0, 0, 0, 0, 0])
    [note] = truth_notes(MONDAY, PosedDrive(TUESDAY, poses), 10.0)
    assert note == (
        "none of 8 queries of tuesday is within 10 m of a scan of monday, so that none has"
        " a right answer: are both in one world frame?"
    )


@pytest.mark.parametrize(
    ("mapped", "queried", "name"),
    [
        (unposed(MONDAY), TUESDAY, "monday"),
        (MONDAY, unposed(TUESDAY), "tuesday"),
        (unposed(MONDAY), None, "monday"),
    ],
)
def test_a_drive_without_poses_is_noted_with_what_cannot_be_checked(mapped, queried, name):
    [note] = truth_notes(mapped, queried, 10.0)
    what = "only the segment" if queried is None else "none"
    assert note == f"drive {name} has no poses: {what} of an answer can be checked"


def test_scans_that_are_left_out_for_their_poses_are_counted():
    poses = POSES.copy()
    poses[[2, 5], 0] = np.nan
    assert list(left_out_notes(MONDAY, PosedDrive(TUESDAY, poses), None)) == [
        "2 of 8 scans of tuesday have no pose and are left out"
    ]
    assert list(left_out_notes(unposed(MONDAY))) == []  # refused with a reason of its own
