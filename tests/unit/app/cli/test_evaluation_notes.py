"""Evaluations note what is wrong with the scans, times and poses of drives, as their builds do."""

import json
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

pytestmark = pytest.mark.slow

SCANS = recording().scans[:24]
COMMANDS = [
    ("evaluate", "--encoding", "paper", "--segments", "2"),
    ("compare", "--methods", "paper", "--segments", "2"),
    ("report", "--encoding", "paper", "--quick", "--k", "12", "--output", "report.html"),
]


@pytest.fixture(params=COMMANDS, ids=lambda words: words[0])
def noted(request, tmp_path: Path, monkeypatch):
    """Return the notes of a command on a drive of some scans, which are beside its figures too."""
    monkeypatch.chdir(tmp_path)

    def notes(scans: Sequence[Scan], *options: object, name: str = "monday") -> str:
        write_kitti_drive(MemoryDrive(name, list(scans)), tmp_path / name)
        said = notes_of(*request.param, name, *options, "--json", "figures.json")
        said = " ".join(said.split())
        for note in json.loads(Path("figures.json").read_text())["notes"]:
            assert note in said
        return said

    return notes


def test_a_drive_that_is_right_is_not_noted(noted):
    said = noted(SCANS)
    assert not re.findall("are equal|decrease|jump|twice|in seconds", said), said


def test_scans_that_repeat_are_noted_since_queries_find_themselves(noted):
    said = noted([scan for scan in SCANS[:12] for _ in range(2)])
    assert "12 of 24 scans of drive monday are equal to the scan before them" in said


def test_times_that_decrease_are_noted_since_they_say_where_the_vehicle_stood(noted):
    times_s = [scan.timestamp_s for scan in SCANS][::-1]
    said = noted([Scan(s.points_m, t, s.pose) for s, t in zip(SCANS, times_s, strict=True)])
    assert "the times of drive monday decrease at 23 of 24 scans, first at scan 1: " in said


def test_a_jump_of_the_poses_is_noted(noted):
    def moved(scan: Scan, metres: float) -> Scan:
        row = np.array(scan.pose.as_tuple())  # type: ignore[union-attr]  # each has one
        row[0] += metres
        return Scan(scan.points_m, scan.timestamp_s, Pose.from_row(row))

    said = noted([moved(scan, 800.0 * (at >= 12)) for at, scan in enumerate(SCANS)])
    assert "the poses of drive monday jump farther than a vehicle moves at 1 of 24 scans" in said


def test_times_in_milliseconds_are_noted_since_the_vehicle_would_seem_to_stand(noted):
    said = noted([Scan(s.points_m, 1e3 * s.timestamp_s, s.pose) for s in SCANS])
    assert re.search(r"scans of drive monday are \d+ s and \S+ m apart, .*times in seconds\?", said)


@pytest.mark.parametrize("folder", ["tuesday", "again/monday"])
def test_a_second_pass_that_is_the_recording_itself_is_noted(tmp_path, folder):
    for scans, name in ((SCANS, "monday"), (SCANS[4:14], folder)):
        write_kitti_drive(MemoryDrive("drive", list(scans)), tmp_path / name)
    said = notes_of(
        "evaluate", tmp_path / "monday", "--query-drive", tmp_path / folder, "--encoding", "paper"
    )
    name = folder.rpartition("/")[2]
    assert f"10 of 10 scans of drive {name} are those of drive monday: " in " ".join(said.split())


def test_scans_that_were_not_read_are_not_taken_for_equal_ones(tmp_path):
    rng = np.random.default_rng(1)
    for at, name in enumerate(("map/monday", "one/day", "two/day")):
        other = [
            Scan(s.points_m + rng.normal(0.0, 0.01 * at, (1, 3)).astype(np.float32), s.timestamp_s,
                 s.pose)
            for s in SCANS
        ]  # fmt: skip
        write_kitti_drive(MemoryDrive("drive", other), tmp_path / name)
    said = notes_of(
        "compare", tmp_path / "map/monday", "--query-drive", tmp_path / "one/day", "--unknown",
        tmp_path / "two/day", "--query-every", "8", "--methods", "paper",
    )  # fmt: skip
    assert "twice" not in said
