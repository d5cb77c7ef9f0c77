"""What `tensormap evaluate` prints, in process."""

import json
import shutil
from pathlib import Path

import pytest

from core.errors import PosesContradictScans
from core.odometry.posed_drive import PosedDrive
from core.scans.drive import MemoryDrive
from core.scans.mounting import Mounting
from core.scans.pose import matrices_from_rows
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from storage.formats.drives.kitti_drive import write_kitti_drive
from tests.support.commands import notes_of, run

pytestmark = pytest.mark.slow


def test_queries_that_cannot_be_used_are_counted_beside_all_of_them(tmp_path) -> None:
    drive = SimulatedDrive(seed=1, scans=12, stops=False, sensor=SimulatedSensor(firings=180))
    write_kitti_drive(drive, tmp_path / "monday")
    (tmp_path / "monday/velodyne/000003.bin").write_bytes(bytes(17))
    out = tmp_path / "figures.json"
    options = ("--split", "every:2", "--yaw-deg", "0,90", "--lateral-renderings=0", "--json", out)
    shown = run("evaluate", tmp_path / "monday", *options)
    rows = json.loads(out.read_text())["conditions"]
    assert [(row["queries"], row["refusals"]) for row in rows] == [(6, 1), (6, 1)]
    assert "; map : images : returns = 1 : " in shown
    assert "unusable: 2 of 12 queries, in no figure but their number\n" in shown


@pytest.mark.parametrize("command", ["build", "evaluate"])
def test_scans_that_are_left_out_are_noted_on_standard_error(tmp_path, command) -> None:
    drive = SimulatedDrive(seed=1, scans=12, stops=False, sensor=SimulatedSensor(firings=180))
    write_kitti_drive(drive, tmp_path / "monday")
    for name in ("000004.bin", "000005.bin"):
        (tmp_path / "monday/velodyne" / name).write_bytes(bytes(17))
    options = ("-o", tmp_path / "map.h5", "--force") if command == "build" else ()
    words = (command, tmp_path / "monday", "--segments", "1", *options)
    assert "tensormap: left out scan 4: " in notes_of(*words)
    assert "left out" not in run(*words)


HEIGHT_M = 1.73
COMMANDS = [
    ("evaluate", "--encoding", "paper", "--segments", "2"),
    ("compare", "--methods", "paper", "--segments", "2"),
    ("report", "--encoding", "paper", "--quick", "--k", "20", "--output", "report.html"),
]


@pytest.fixture(scope="module")
def along_y(tmp_path_factory):
    """A drive as a sensor records it that has x to the right, as the Ford Campus laser."""
    drive = SimulatedDrive(seed=5, scans=60, stops=False, sensor=SimulatedSensor(firings=180))
    turned, back = (Mounting(0.0, 0.0, HEIGHT_M, yaw_deg=yaw) for yaw in (-90.0, 90.0))
    scans = [Scan(back.mount(drive.scan(i), HEIGHT_M).points_m) for i in range(len(drive))]
    path = tmp_path_factory.mktemp("right") / "ford"
    write_kitti_drive(
        PosedDrive(MemoryDrive("ford", scans), turned.sensor_poses(drive.poses)), path
    )
    return path


@pytest.mark.parametrize("command", COMMANDS, ids=lambda words: words[0])
def test_a_drive_along_another_axis_is_noted_until_its_mounting_turns_it(
    along_y, tmp_path, monkeypatch, command
) -> None:
    monkeypatch.chdir(tmp_path)
    name, *options = command
    noted = notes_of(name, along_y, *options)
    assert "tensormap: drive ford moves along +y of its frame in 100% of its steps" in noted
    assert "turn the drive's mounting by yaw_deg -90" in noted
    mounted = notes_of(name, along_y, *options, "--mounting", f"0,0,{HEIGHT_M},0,0,-90")
    assert "moves along" not in mounted


def test_a_second_drive_along_another_axis_is_noted_too(along_y) -> None:
    options = ("--encoding", "paper", "--segments", "2", "--query-drive", along_y)
    noted = notes_of("evaluate", along_y, *options, "--mounting", f"0,0,{HEIGHT_M},0,0,-90")
    assert "moves along" not in noted
    noted = notes_of("evaluate", along_y, *options, "--query-mounting", f"0,0,{HEIGHT_M}")
    assert noted.count("moves along +y") == 2


@pytest.fixture(scope="module")
def registered(tmp_path_factory):
    """A drive whose scans are in the map's frame already, as SLAM exports them."""
    drive = SimulatedDrive(seed=5, scans=60, stops=False, sensor=SimulatedSensor(firings=180))
    poses = matrices_from_rows(drive.poses)
    scans = [
        Scan(drive.scan(i).points_m @ pose[:3, :3].T + pose[:3, 3]) for i, pose in enumerate(poses)
    ]
    path = tmp_path_factory.mktemp("map") / "slam"
    write_kitti_drive(PosedDrive(MemoryDrive("slam", scans), drive.poses), path)
    return path


@pytest.mark.parametrize("command", COMMANDS, ids=lambda words: words[0])
def test_scans_that_a_build_refuses_are_evaluated_with_a_note_beside_the_figures(
    registered, tmp_path, monkeypatch, command
) -> None:
    monkeypatch.chdir(tmp_path)
    name, *options = command
    noted = notes_of(name, registered, *options, "--json", "figures.json")
    note = "the scans of drive slam are in the frame of its poses, as clouds that SLAM"
    assert noted.count(f"tensormap: {note}") == 1
    [kept] = json.loads(Path("figures.json").read_text())["notes"]
    assert kept.startswith(note)
    if name == "report":
        assert note in Path("report.html").read_text()


def test_an_evaluation_notes_what_a_build_that_does_not_check_notes(along_y, tmp_path) -> None:
    """Of poses that are in the wrong order, and those of other axes."""
    wrong = tmp_path / "wrong"
    shutil.copytree(along_y, wrong)
    lines = (wrong / "poses.txt").read_text().splitlines()
    (wrong / "poses.txt").write_text("\n".join(reversed(lines)))
    paper = ("--encoding", "paper")  # the fastest one: poses are checked by the scans alone
    with pytest.raises(PosesContradictScans):
        run("build", wrong, "-o", tmp_path / "map.h5", *paper)
    built = notes_of("build", wrong, "-o", tmp_path / "map.h5", "--align", "off", *paper)
    noted = notes_of("evaluate", wrong, "--json", tmp_path / "figures.json", *paper)
    notes = json.loads((tmp_path / "figures.json").read_text())["notes"]
    assert ["contradict its poses" in note for note in notes] == [True, False]
    assert "moves along -y of its frame" in notes[1]
    for note in notes:
        assert f"tensormap: {note}\n" in built
        assert f"tensormap: {note}\n" in noted


def test_a_drive_without_poses_and_one_that_is_right_are_evaluated_as_before(tmp_path) -> None:
    drive = SimulatedDrive(seed=1, scans=24, stops=False, sensor=SimulatedSensor(firings=180))
    write_kitti_drive(drive, tmp_path / "monday")
    out = tmp_path / "figures.json"
    run("evaluate", tmp_path / "monday", "--segments", "2", "--json", out)
    assert json.loads(out.read_text())["notes"] == []
    (tmp_path / "monday" / "poses.txt").unlink()
    run("evaluate", tmp_path / "monday", "--segments", "2", "--json", out)
    assert json.loads(out.read_text())["notes"] == [
        "drive monday has no poses: only the segment of an answer can be checked"
    ]


def test_scans_without_a_pose_are_counted_as_they_are_in_no_recall(tmp_path) -> None:
    drive = SimulatedDrive(seed=1, scans=12, stops=False, sensor=SimulatedSensor(firings=180))
    poses = drive.poses.copy()
    poses[3:6] = float("nan")
    write_kitti_drive(PosedDrive(drive, poses), tmp_path / "monday")
    noted = notes_of("evaluate", tmp_path / "monday", "--split", "every:2", "--segments", "1")
    assert "3 of 12 scans of monday have no pose: no recall counts them, nor answers" in " ".join(
        noted.split()
    )
    write_kitti_drive(drive, tmp_path / "whole")
    noted = notes_of("evaluate", tmp_path / "whole", "--split", "every:2", "--segments", "1")
    assert "no pose" not in noted


def test_queries_off_the_map_are_left_out_of_the_probabilities_and_counted(tmp_path) -> None:
    sensor = SimulatedSensor(firings=180)
    for name, seed, scans in (("monday", 0, 60), ("longer", 0, 90), ("far", 5, 10)):
        drive = SimulatedDrive(seed=seed, scans=scans, stops=False, sensor=sensor)
        write_kitti_drive(drive, tmp_path / name)
    out = tmp_path / "figures.json"
    options = ("--encoding", "paper", "--query-drive", tmp_path / "longer", "--segments", "4")
    unknown = ("--unknown", tmp_path / "far", "--json", out)
    shown = run("evaluate", tmp_path / "monday", *options, *unknown)
    [row] = json.loads(out.read_text())["conditions"]
    known, left_out = row["findable"]["10"], 90 - row["findable"]["10"]
    assert left_out > 0
    assert row["reliability"]["known_queries"] == known
    assert row["reliability"]["off_map_queries"] == left_out
    text = f"known places: {known} queries; {left_out} without a map scan within 10 m left out"
    assert text in " ".join(shown.split())
