"""`--protocol` of the commands of evaluation, in process, and their tables."""

import errno
import json
import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli.evaluation import show_table
from app.cli.main import cli
from core.errors import InvalidParameters
from core.scans.drive import MemoryDrive
from core.scans.pose import Pose
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from storage.formats.drives.kitti_drive import write_kitti_drive
from tests.support.commands import called, run

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Two passes, 24 scans 10 m apart, the second 1 m beside the first; and a drive round."""
    folder = tmp_path_factory.mktemp("drives")
    few = SimulatedSensor(firings=180)
    for name, traffic in (("monday", 1), ("tuesday", 2)):
        drive = SimulatedDrive(
            seed=1, scans=24, speed_m_s=100.0, stops=False, traffic_seed=traffic, sensor=few,
            lateral_offset_m=float(traffic - 1),
        )  # fmt: skip
        write_kitti_drive(drive, folder / name)
    return folder


def test_ring_thins_both_drives_and_prints_the_number_of_queries(folders, tmp_path):
    out = tmp_path / "figures.json"
    words = (folders / "monday", "--query-drive", folders / "tuesday", "--protocol", "ring")
    printed = run("compare", *words, "--methods", "harmonic", "--json", out)
    written = json.loads(out.read_text())
    assert written["protocol"] == (
        "ring: a scan each 20 m mapped, of another drive each 5 m query; right within 25 m without"
        " heights"
    )
    [row] = written["methods"][0]["conditions"]
    assert list(row["recall_at_1"]) == ["25", "10"]
    assert f"{row['queries']} queries, findable {row['findable']['25']} within 25 m" in " ".join(
        printed.split()
    )
    assert row["findable"]["25"] == row["queries"] <= 24
    assert written["methods"][0]["places"] <= 13
    evaluated = tmp_path / "evaluated.json"
    printed = run("evaluate", *words, "--segments", "1", "--json", evaluated)
    figures = json.loads(evaluated.read_text())
    assert figures["protocol"] == written["protocol"]
    assert figures["map_scans"] == written["methods"][0]["places"]
    assert list(figures["conditions"][0]["recall_at_1"]) == ["25"]
    assert f"{row['queries']} answered queries, findable {row['queries']} within 25 m" in " ".join(
        printed.split()
    )
    assert f"{row['queries']} have a place within 25 m and count" in " ".join(printed.split())


@pytest.mark.parametrize("words", [("evaluate",), ("compare", "--methods", "harmonic")])
def test_figures_are_in_their_file_also_where_the_table_cannot_be_printed(
    folders, tmp_path, monkeypatch, words
):
    def closed(_result):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    command, *options = words
    monkeypatch.setattr(f"app.cli.{command}._show", closed)
    out = tmp_path / "figures.json"
    called(command, folders / "monday", *options, "--json", out, status=1)
    figures = json.loads(out.read_text())
    assert figures["drive"] == "monday"
    assert figures["data"] == str(folders / "monday")
    assert figures["provenance"].keys() >= {"tensormap", "commit", "machine", "threads"}


def test_loops_are_compared_and_not_evaluated(folders):
    with pytest.raises(InvalidParameters, match=r"logg3d closes loops.*compare --protocol logg3d"):
        run("evaluate", folders / "monday", "--protocol", "logg3d")
    with pytest.raises(InvalidParameters, match=r"monday is too short for loop closing"):
        run("compare", folders / "monday", "--protocol", "scancontext", "--methods", "harmonic")


@pytest.mark.parametrize("words", [("evaluate",), ("compare", "--methods", "scan-context")])
def test_drives_in_different_world_frames_are_evaluated_with_a_note(folders, tmp_path, words):
    shutil.copytree(folders / "tuesday", tmp_path / "utm")
    lines = np.loadtxt(tmp_path / "utm" / "poses.txt")
    np.savetxt(tmp_path / "utm" / "poses.txt", lines + np.eye(12)[3] * 5e5)
    command, *options = words
    words = (command, folders / "monday", "--query-drive", tmp_path / "utm", *options)
    result = CliRunner().invoke(cli, list(map(str, words)))
    assert result.exit_code == 0
    assert "none of 24 queries of utm is within 10 m of a scan of monday" in result.stderr


def test_a_part_of_a_sequence_of_kitti_is_not_checked_by_its_revisits(folders, tmp_path):
    shutil.copytree(folders / "monday", tmp_path / "08")
    result = CliRunner().invoke(cli, ["evaluate", str(tmp_path / "08"), "--protocol", "solid"])
    assert isinstance(result.exception, InvalidParameters)
    assert "has 4071 scans, this drive 24: its revisits are not" in " ".join(result.stdout.split())


@pytest.mark.parametrize(
    ("command", "words", "named"),
    [
        ("compare", ["--loop", "--recent-s", "30"], "leave out --loop, --recent-s"),
        ("compare", ["--split", "every:2"], "leave out --split"),
        ("compare", ["--query-every", "1"], "leave out --query-every"),
        ("compare", ["--tolerance-m", "3"], "leave out --tolerance-m"),
        ("evaluate", ["--split", "every:2", "--tolerance-m", "3"], "leave out --split, --tol"),
    ],
)
def test_what_a_protocol_fixes_cannot_be_given_beside_it(folders, command, words, named):
    with pytest.raises(InvalidParameters, match=f"--protocol solid chooses map.*{named}"):
        run(command, folders / "monday", "--protocol", "solid", *words)


def test_a_drive_without_rules_and_an_unknown_protocol_are_refused(folders):
    with pytest.raises(InvalidParameters, match=r"bevplace has rules for KITTI.*'monday' in the"):
        run("compare", folders / "monday", "--protocol", "bevplace")
    with pytest.raises(InvalidParameters, match="no protocol 'kitti'"):
        run("evaluate", folders / "monday", "--protocol", "kitti")


def test_the_revisits_of_a_sequence_of_kitti_are_compared_with_the_known_ones(tmp_path):
    # 1,101 scans, as many as sequence 07, along a line that never comes back: 07 does 10 times.
    points = np.array([[5.0, 0.0, 1.0]], np.float32)
    scans = [Scan(points, timestamp_s=0.1 * i, pose=Pose(1.0 * i, 0.0, 0.0)) for i in range(1101)]
    write_kitti_drive(MemoryDrive("07", scans), tmp_path / "07")
    words = (tmp_path / "07", "--protocol", "ring")  # refused after the check: it is of two drives
    result = CliRunner().invoke(cli, ["compare", *map(str, words)])
    assert isinstance(result.exception, InvalidParameters)
    assert " ".join(result.stdout.split()) == (
        "revisits of every third scan, within 3 m after more than 30 s: 0 (0 in reverse); known of"
        " KITTI 07: 10 (0 in reverse); are these the poses of the sequence?"
    )


@pytest.mark.parametrize("columns", [40, 60, 79, 80])
def test_figures_that_do_not_fit_a_terminal_are_tables_below_one_another(
    monkeypatch, capsys, columns
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    headings = ["yaw deg", "left m", *(f"figure {letter}" for letter in "abcdefghijklm")]
    rows = [["90", "-1.5", *(f"{row}{number:02}" for number in range(13))] for row in (1, 2)]
    show_table(headings, rows, title="tracked", repeated=2)
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= columns
    assert all(shown.count(cell) == 1 for row in rows for cell in row[2:])
    tables = sum(line.strip("─ ") == "" and "─" in line for line in shown.splitlines())
    assert tables > 1
    assert shown.count("-1.5") == 2 * tables  # the first columns are in each
    assert shown.count("tracked") == 1


def test_figures_that_fit_are_one_table(monkeypatch, capsys) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    show_table(["yaw deg", *(f"figure {n}" for n in range(9))], [["90"] * 10], repeated=1)
    assert capsys.readouterr().out.count("90") == 10
