"""Mounted and accumulated scans in the commands, in process."""

import json

import numpy as np
import pytest

from core import MapParameters, MemoryDrive, build_map
from core.errors import InvalidParameters
from core.scans.mounting import vehicle_drive
from core.scans.tilt import Tilt
from storage.files.map_file import read_map
from storage.formats.drives.kitti_drive import write_kitti_drive
from storage.formats.drives.layouts import open_drive
from tests.support.commands import run
from tests.support.mounted import ASKEW, mounted_recording, tilted, vehicle_poses
from tests.support.recording import kitti, recording

pytestmark = pytest.mark.slow

TEXT = str(ASKEW)
AS_MOUNTED = ("--mounting", TEXT)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A drive of the mounted sensor, whole and sparse, and one of a level sensor."""
    folder = tmp_path_factory.mktemp("drives")
    for drive in (
        mounted_recording(),
        mounted_recording(name="sparse", sparse=True),
        MemoryDrive("level", recording().scans),
    ):
        write_kitti_drive(drive, folder / drive.name)
    return folder


@pytest.fixture(scope="module")
def map_file(folders):
    path = folders / "askew.h5"
    run("build", folders / "askew", "-o", path, "--segments", "2", *AS_MOUNTED)
    return path


def answers(*words):
    return [json.loads(line) for line in run("localize", *words, "--json").splitlines()]


def off_m(answer, index):
    pose = answer["best"]["estimated_pose"]
    return np.hypot(*(vehicle_poses()[index, :2] - (pose["x_m"], pose["y_m"])))


def test_a_map_is_built_of_the_vehicles_drive_at_the_mountings_height(folders, map_file):
    built = read_map(map_file)
    parameters = MapParameters.for_sensor(sensor_height_m=ASKEW.z_m)
    drive = vehicle_drive(open_drive(folders / "askew", min_returns=100), ASKEW, ASKEW.z_m)
    assert built.revision == build_map(drive, parameters, segments=2).revision
    np.testing.assert_allclose(built.trajectory.poses, vehicle_poses(), atol=1e-6)


@pytest.mark.parametrize("command", ["evaluate", "compare"])
def test_a_mounting_of_queries_without_a_drive_of_queries_is_refused(folders, command):
    with pytest.raises(InvalidParameters, match="--query-mounting is of DRIVE2 and DRIVE3"):
        run(command, folders / "level", "--segments", "2", "--query-mounting", TEXT)


def test_accumulated_scans_are_one_scan_of_a_map(folders, tmp_path):
    out = tmp_path / "map.h5"
    options = ("--segments", "2", "--accumulate", "5", *AS_MOUNTED)
    run("build", folders / "sparse", "-o", out, *options)
    assert read_map(out).trajectory.scan_index.tolist() == [*range(4, 48, 5), 47]


def test_scan_files_of_a_mounted_sensor_are_localized(folders, map_file):
    scan = folders / "askew" / "velodyne" / "000020.bin"
    [found] = answers(map_file, scan, *AS_MOUNTED)
    assert found["best"]["scan_index"] == 20
    assert off_m(found, 20) < 0.5
    [level] = answers(map_file, folders / "level" / "velodyne" / "000020.bin",
                      "--mounting", "0,0,1.73")  # fmt: skip
    assert off_m(level, 20) < 2.0


def test_a_drive_is_localized_scan_by_scan_or_several_at_a_time(folders, map_file, monkeypatch):
    found = answers(map_file, folders / "sparse", "--accumulate", "8", *AS_MOUNTED)
    assert len(found) == 6
    assert np.median([off_m(a, i) for a, i in zip(found, range(7, 48, 8), strict=True)]) < 2.0
    assert len(answers(map_file, folders / "level")) == 48
    monkeypatch.setenv("COLUMNS", "160")
    assert "level 47" in run("localize", map_file, folders / "level")


def test_a_signature_is_of_the_mounted_scan(folders, map_file):
    scan = folders / "askew" / "velodyne" / "000020.bin"
    [shown] = json.loads(run("signature", map_file, scan, *AS_MOUNTED))["signatures"]
    stored = read_map(map_file).model.signatures[20]
    viewpoint = stored[len(stored) // 2, :6, :7]
    step = np.abs(stored[len(stored) // 2]).max() / 127
    np.testing.assert_allclose(shown["values_real"], viewpoint.real, atol=0.51 * step)


def test_loop_closures_are_between_vehicles(folders):
    words = ("loop-closure", folders / "askew", "10,11", "--sensor-height-m", "1.9", "--json")
    found = json.loads(run(*words, *AS_MOUNTED))
    assert found["forward_m"] == pytest.approx(1.5, abs=0.5)
    assert found["lateral_m"] == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize("command", ["evaluate", "compare"])
def test_drives_of_two_mountings_are_evaluated_in_the_vehicles_frame(folders, tmp_path, command):
    out = tmp_path / "figures.json"
    methods = ("--methods", "harmonic") if command == "compare" else ()
    options = (*AS_MOUNTED, "--query-mounting", "0,0,1.73", "--accumulate", "2", *methods)
    run(command, folders / "askew", "--query-drive", folders / "level", *options, "--json", out)
    figures = json.loads(out.read_text())
    of_it = figures["methods"][0] if command == "compare" else figures
    [condition] = of_it["conditions"]
    assert condition["queries"] == 24
    assert condition["heading_error_deg_median"] < 3.0
    assert condition["recall_at_1"]["3"] > 0.9


def test_options_that_do_not_fit_are_refused(folders, map_file):
    scan = folders / "askew" / "velodyne" / "000020.bin"
    with pytest.raises(InvalidParameters, match="wants the folder of a drive"):
        run("localize", map_file, scan, "--accumulate", "2")
    with pytest.raises(InvalidParameters, match="leave --sensor-height-m out"):
        run("localize", map_file, scan, "--sensor-height-m", "2", *AS_MOUNTED)
    with pytest.raises(SystemExit):
        run("localize", map_file, scan, "--mounting", "1,2")


def test_gravity_levels_a_scan_that_sees_no_ground(folders, map_file, tmp_path):
    tilt = Tilt(roll_deg=-5.0, pitch_deg=8.0)
    level, leaning = tmp_path / "level.bin", tmp_path / "leaning.bin"
    for path, each in ((level, Tilt(0.0, 0.0)), (leaning, tilt)):
        path.write_bytes(kitti(tilted(mounted_recording().scan(20), each, ASKEW, ASKEW.z_m)))
    gravity = ("--roll-deg=-5", "--pitch-deg=8")
    [expected] = answers(map_file, level, *AS_MOUNTED)
    [with_it] = answers(map_file, leaning, *AS_MOUNTED, *gravity)
    [without] = answers(map_file, leaning, *AS_MOUNTED)
    assert with_it["best"]["distance"] == pytest.approx(expected["best"]["distance"], abs=1e-3)
    assert without["best"]["distance"] > 2.0 * expected["best"]["distance"]
    signed, wanted = (
        json.loads(run("signature", map_file, *words, *AS_MOUNTED))["signatures"][0]
        for words in ((leaning, *gravity), (level,))
    )
    largest = np.abs(wanted["values_real"]).max()
    np.testing.assert_allclose(signed["values_real"], wanted["values_real"], atol=1e-2 * largest)


@pytest.mark.parametrize("command", ["localize", "signature"])
@pytest.mark.parametrize(
    "words",
    [["--roll-deg=3"], ["--roll-deg=nan", "--pitch-deg=0"], ["--roll-deg=0", "--pitch-deg=60"]],
)
def test_what_is_no_tilt_is_rejected(folders, map_file, command, words):
    scan = folders / "askew" / "velodyne" / "000020.bin"
    with pytest.raises(InvalidParameters, match="wanted"):
        run(command, map_file, scan, *words)


def test_poses_are_checked_and_computed_at_the_height_of_the_mounted_sensor(
    folders, tmp_path, monkeypatch
):
    heights_m = []

    def checked(_drive, sensor_height_m, *_):
        heights_m.append(sensor_height_m)
        return ()

    def posed(drive, sensor_height_m, _):
        heights_m.append(sensor_height_m)
        return drive, ()

    monkeypatch.setattr("app.builds.pose_checks.check_recorded", checked)
    monkeypatch.setattr("app.builds.odometry.pose_recorded", posed)
    words = ("build", folders / "sparse", "-o", tmp_path / "map.h5", "--sensor-height-m", "1.5")
    paper = ("--encoding", "paper")
    run(*words, *paper, *AS_MOUNTED)
    run(*words, *paper, "--force")
    assert heights_m == [ASKEW.z_m, ASKEW.z_m, 1.5, 1.5]
