"""`tensormap compare`, in process."""

import json

import numpy as np
import pytest

from baselines.roster import BY_SCAN, METHODS, default_methods
from core.errors import InvalidParameters, TensorMapError
from core.odometry.posed_drive import PosedDrive
from core.projection.imager import Views
from storage.formats.drives.kitti_drive import write_kitti_drive
from tests.support.commands import notes_of, run
from tests.support.samples import sample_drive

pytestmark = pytest.mark.slow

OURS = ",".join(METHODS[:-1])


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Two passes over one line, and another place."""
    folder = tmp_path_factory.mktemp("drives")
    for name, seed in (("monday", 0), ("tuesday", 0), ("elsewhere", 5)):
        write_kitti_drive(sample_drive(12, seed, returns=150), folder / name)
    return folder


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """A drive of three scans, which is looked through in no time."""
    folder = tmp_path_factory.mktemp("short")
    write_kitti_drive(sample_drive(3), folder / "monday")
    return folder / "monday"


def test_every_method_is_queried_and_the_figures_are_written(folders, tmp_path):
    out = tmp_path / "figures.json"
    printed = run("compare",
        folders / "monday", "--methods", OURS, "--split", "every:2", "--segments", "2",
        "--yaw-deg=0,-90", "--unknown", folders / "elsewhere", "--query-every", "3",
        "--json", out,
    )  # fmt: skip
    written = json.loads(out.read_text())
    assert [method["name"] for method in written["methods"]] == list(METHODS[:-1])
    assert written["provenance"].keys() >= {"tensormap", "commit", "machine", "threads"}
    assert written["data"] == str(folders / "monday")
    assert (written["protocol"], written["unknown_drive"]) == ("held out every:2", "elsewhere")
    assert [row["yaw_deg"] for row in written["methods"][0]["conditions"]] == [0.0, -90.0]
    for method in written["methods"]:
        assert method["name"] in printed
        assert method["configuration"]
        assert 0.0 <= method["conditions"][0]["novelty_auroc"] <= 1.0
        assert method["conditions"][0]["describe_ms_median"] > 0
    assert "average precision" in printed


def test_of_any_views_whole_scans_are_queries_beside_signatures(folders, tmp_path):
    out = tmp_path / "figures.json"
    options = ["--split", "every:2", "--segments", "2", "--json", out]
    run("compare", folders / "monday", "--views", "any", "--methods", "harmonic,harmonic-scan",
        *options)  # fmt: skip
    signature, scan = json.loads(out.read_text())["methods"]
    assert (signature["name"], scan["name"]) == ("harmonic", "harmonic-scan")
    assert (scan["sent_bytes"], scan["stored_bytes"]) == (None, signature["stored_bytes"] + 1200)
    assert set(BY_SCAN) <= set(default_methods(Views.ANY))
    with pytest.raises(InvalidParameters, match="harmonic-scan wants views any"):
        run("compare", folders / "monday", "--methods", "harmonic-scan", "--views", "full",
            *options)  # fmt: skip


def test_a_second_pass_finds_itself(folders, tmp_path):
    out = tmp_path / "figures.json"
    run("compare",
        folders / "monday", "--query-drive", folders / "tuesday", "--methods", OURS,
        "--tolerance-m", "0.5", "--json", out,
    )  # fmt: skip
    written = json.loads(out.read_text())
    assert (written["protocol"], written["query_drive"]) == ("second pass", "tuesday")
    for method in written["methods"]:
        assert method["conditions"][0]["recall_at_1"] == {"0.5": 1.0}


def test_loops_are_searched_among_earlier_scans(folders, tmp_path):
    out = tmp_path / "figures.json"
    options = ["--methods", "solid, harmonic", "--json", out]
    run("compare", folders / "monday", "--loop", "--recent-scans", "5", *options)
    written = json.loads(out.read_text())
    assert written["protocol"] == "loop closing, with places at least 5 scans before"
    assert written["methods"][0]["conditions"][0]["queries"] == 7
    assert written["methods"][0]["conditions"][0]["findable"]["3"] == 0
    assert written["methods"][0]["conditions"][0]["recall_at_1"]["3"] is None
    run("compare", folders / "monday", "--loop", "--recent-s", "0.45", *options)
    assert json.loads(out.read_text())["protocol"].endswith("at least 0.45 s before")


def test_scans_without_a_pose_are_left_out_with_a_note(tmp_path):
    drive = sample_drive(12, returns=150)
    poses = drive.poses.copy()
    poses[[3, 4]] = np.nan
    write_kitti_drive(PosedDrive(drive, poses), tmp_path / "monday")
    words = ("compare", tmp_path / "monday", "--methods", "solid", "--split", "every:2")
    assert "2 of 12 scans of monday have no pose and are left out\n" in notes_of(*words)


def test_what_a_method_did_not_answer_is_printed_under_its_condition(tmp_path):
    write_kitti_drive(sample_drive(12, returns=150), tmp_path / "monday")
    (tmp_path / "monday/velodyne/000003.bin").write_bytes(bytes(17))
    options = ("--methods", "solid", "--split", "every:2", "--yaw-deg", "0,90")
    printed = run("compare", tmp_path / "monday", *options)
    _, first, second = printed.split("\nyaw ")
    for condition in (first, second):
        assert condition.count("solid: 1 query not described, 0 without an answer") == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--methods", "orb"], "no method 'orb'; known are paper, harmonic"),
        (["--methods", "solid,solid"], "each once"),
        (["--methods", "solid,"], "--methods is 'solid,', wanted names between single commas"),
        (["--loop", "--split", "every:2"], "of one whole drive"),
        (["--loop", "--recent-scans", "3", "--recent-s", "2"], "one of them"),
        (["--loop"], "exclude less"),
        (["--recent-s", "2"], "are of --loop"),
        (["--query-every", "3"], "--query-every is of --query-drive and --unknown"),
        (["--query-drive", ".", "--split", "every:2"], "leave --split out"),
        (["--split", "half"], "wanted interleaved"),
        (["--sensor", "eye"], "no sensor 'eye'"),
        (["--tolerance-m", "0"], "metres above 0"),
    ],
)
def test_invalid_input_is_rejected_with_a_message(short, options, message):
    methods = [] if "--methods" in options else ["--methods", "solid"]
    with pytest.raises(InvalidParameters, match=message):
        run("compare", short, *methods, *options)


def test_an_invalid_list_and_a_path_that_cannot_be_written_are_rejected(folders, tmp_path):
    for options in (["--yaw-deg", "north"], ["--json", tmp_path / "no" / "such.json"]):
        with pytest.raises(SystemExit):
            run("compare", folders / "monday", *options)


def test_an_empty_folder_is_no_drive(tmp_path):
    with pytest.raises(TensorMapError, match="has none of"):
        run("compare", tmp_path)
