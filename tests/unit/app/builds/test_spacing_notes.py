"""Builds say that scans are too far apart."""

import numpy as np
import pytest

from app.builds.spacing_notes import spacing_notes
from core.scans.trajectory import Trajectory


def driven(step_m, stop=0):
    along_m = np.concatenate([np.zeros(stop), np.arange(40) * step_m])
    poses = np.zeros((len(along_m), 7))
    poses[:, 0], poses[:, 6] = along_m, 1.0
    return Trajectory.of_drive("monday", np.arange(len(poses)) / 10, poses, np.arange(len(poses)))


@pytest.mark.parametrize("stop", [0, 200])
def test_a_drive_with_a_scan_every_seven_metres_is_noted_with_its_spacing(stop):
    [note] = spacing_notes(driven(7.0, stop))
    assert note.startswith("scans of drive monday are 7.0 m apart: ")
    assert note.endswith("map scans, also accumulated ones, that are 2 to 4 m apart")


def test_a_drive_with_a_scan_every_four_metres_is_not():
    assert not list(spacing_notes(driven(4.0)))


def test_nothing_is_said_of_drives_without_poses_or_of_one_scan():
    unknown = driven(7.0)
    poses = np.full_like(unknown.poses, np.nan)
    no_poses = Trajectory.of_drive("a", unknown.timestamp_s, poses, np.arange(len(poses)))
    assert not list(spacing_notes(no_poses))
    assert not list(spacing_notes(unknown.select(np.array([3]))))


@pytest.mark.parametrize("places", [[20], [15, 25]])
@pytest.mark.parametrize("timed", [True, False])
def test_jumps_of_the_poses_are_no_spacing_of_scans(places, timed):
    dense = driven(1.0)
    poses, timestamp_s = dense.poses.copy(), dense.timestamp_s + np.zeros(len(dense.poses))
    for place in places:
        poses[place:, 0] += 800.0
    if not timed:
        timestamp_s[:] = np.nan
    assert not list(spacing_notes(Trajectory.of_drive("a", timestamp_s, poses, np.arange(40))))


def test_a_gap_in_the_recording_is_no_spacing_of_scans():
    dense = driven(1.0)
    poses, timestamp_s = dense.poses.copy(), dense.timestamp_s.copy()
    poses[20:, 0] += 100.0
    timestamp_s[20:] += 10.0
    assert not list(spacing_notes(Trajectory.of_drive("a", timestamp_s, poses, np.arange(40))))
