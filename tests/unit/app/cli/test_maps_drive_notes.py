"""`tensormap build` notes what is wrong with its drives, as the builds of a service do."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from core.scans.drive import MemoryDrive
from core.scans.pose import Pose
from core.scans.scan import Scan
from storage.formats.drives.kitti_drive import write_kitti_drive
from tests.support.commands import notes_of
from tests.support.recording import recording

SCANS = recording().scans[:24]


@pytest.fixture
def built(tmp_path: Path):
    """Return the notes of a build of drives."""

    def build(*drives: Sequence[Scan], options: Sequence[str] = ()) -> str:
        folders = [tmp_path / name for name in ("monday", "tuesday")[: len(drives)]]
        for scans, folder in zip(drives, folders, strict=True):
            write_kitti_drive(MemoryDrive(folder.name, list(scans)), folder)
        said = notes_of(
            "build", *folders, "-o", tmp_path / "map.h5", "--segments", "1", "--align", "off",
            "--encoding", "paper", *options,
        )  # fmt: skip
        return " ".join(said.split())

    return build


def test_drives_that_are_right_are_not_noted(built):
    said = built(SCANS)
    assert not re.findall("are equal|decrease|no pose|jump|m apart:|twice", said), said


def test_times_that_decrease_are_noted(built):
    times_s = [scan.timestamp_s for scan in SCANS][::-1]
    scans = [Scan(s.points_m, time_s, s.pose) for s, time_s in zip(SCANS, times_s, strict=True)]
    assert "the times of drive monday decrease at 23 of 24 scans, first at scan 1: " in built(scans)


def test_scans_without_a_pose_are_counted(built):
    scans = [Scan(s.points_m, s.timestamp_s, s.pose if at > 4 else None)
             for at, s in enumerate(SCANS)]  # fmt: skip
    assert "5 of 24 scans of drive monday have no pose" in built(scans)


@pytest.mark.parametrize("accumulate", [1, 2])
def test_scans_that_a_frozen_sensor_repeats_are_noted_by_their_numbers(built, accumulate):
    scans = [Scan(SCANS[max(at - 7, min(at, 4))].points_m, s.timestamp_s, s.pose)
             for at, s in enumerate(SCANS)]  # fmt: skip
    assert (
        "7 of 24 scans of drive monday are equal to the scan before them, most in a row are scans 4"
        " to 11: did the sensor or its driver stop, and send its last scan again?"
    ) in built(scans, options=["--accumulate", str(accumulate)])


def test_one_recording_under_two_names_is_noted(built):
    assert (
        "10 of 10 scans of drive tuesday are those of drive monday: is one recording there"
        " twice? Leave one out"
    ) in built(SCANS, SCANS[4:14])


def test_a_jump_of_the_poses_is_noted_and_no_other_distance_is_advised(built):
    def moved(scan: Scan, metres: float) -> Scan:
        row = np.array(scan.pose.as_tuple())  # type: ignore[union-attr]  # each has one
        row[0] += metres
        return Scan(scan.points_m, scan.timestamp_s, Pose.from_row(row))

    said = built([moved(scan, 800.0 * (at >= 12)) for at, scan in enumerate(SCANS)])
    assert (
        "the poses of drive monday jump farther than a vehicle moves at 1 of 24 scans, first at"
        " scan 12: are they another drive's?"
    ) in said
    assert "map scans, also accumulated ones" not in said
