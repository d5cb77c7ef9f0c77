"""The commands that put several drives into one map."""

import json
from dataclasses import replace

import numpy as np
import pytest

from core.errors import (
    BasisMismatch,
    EmptyDrive,
    FramesDisagree,
    InvalidParameters,
    UnknownDrive,
)
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from storage.files.map_file import read_map
from storage.formats.drives.kitti_drive import write_kitti_drive
from tests.support.commands import notes_of, run
from tests.support.odometry import needs_odometry
from tests.support.recording import kitti, recording

pytestmark = pytest.mark.slow

HARMONIC = ("--lateral-renderings=-1.5,0,1.5", "--no-odometry")
FULL = (*HARMONIC, "--views", "full")
"""Built in half of the time, where nothing depends on views."""


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Two drives as scan files, `monday` and `tuesday`."""
    parent = tmp_path_factory.mktemp("drives")
    for name, first in (("monday", 0), ("tuesday", 10)):
        (parent / name).mkdir()
        for index, scan in enumerate(recording(scans=20).scans[first : first + 10]):
            (parent / name / f"{index:06}.bin").write_bytes(kitti(scan))
    return parent / "monday", parent / "tuesday"


@pytest.fixture(scope="module")
def maps(folders, tmp_path_factory):
    """Maps of one drive each; the second keeps the basis of the first."""
    monday, tuesday = (tmp_path_factory.mktemp("maps") / f"{f.name}.h5" for f in folders)
    run("build", folders[0], "-o", monday, *HARMONIC)
    run("build", folders[1], "-o", tuesday, *HARMONIC, "--keep-basis", monday)
    return monday, tuesday


def test_merged_files_are_the_map_of_both_drives(maps, folders, tmp_path):
    message = run("merge", *maps, "-o", tmp_path / "both.h5")
    assert "monday, tuesday: 20 scans" in message
    run("build", *folders, "-o", tmp_path / "whole.h5", *HARMONIC, "--keep-basis", maps[0])
    merged = read_map(tmp_path / "both.h5")
    whole = read_map(tmp_path / "whole.h5")
    uncalibrated = replace(whole, calibration=None, image_calibration=None)
    assert merged.revision == uncalibrated.revision  # files hold no probes
    facts = json.loads(run("inspect", tmp_path / "both.h5", "--json"))
    assert facts["basis"] == read_map(maps[0]).basis_digest


def test_a_drive_is_left_out_of_a_file(maps, tmp_path):
    run("merge", *maps, "-o", tmp_path / "both.h5")
    run("merge", tmp_path / "both.h5", "--without", "monday", "-o", tmp_path / "one.h5")
    tuesday = replace(read_map(maps[1]), calibration=None, image_calibration=None)
    assert read_map(tmp_path / "one.h5").revision == tuesday.revision


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """Two passes of the same streets, the second's poses in another world frame."""
    parent = tmp_path_factory.mktemp("frames")
    for seed, name in enumerate(("monday", "tuesday")):
        drive = SimulatedDrive(
            seed=1, scans=48, stops=False, noise_seed=seed, sensor=SimulatedSensor(firings=180)
        )
        write_kitti_drive(drive, parent / name)
    rows = np.loadtxt(parent / "tuesday" / "poses.txt")
    rows[:, 3] += 500.0
    np.savetxt(parent / "tuesday" / "poses.txt", rows)
    return parent / "monday", parent / "tuesday"


def test_drives_in_different_world_frames_are_rejected_or_aligned(frames, tmp_path):
    monday, tuesday = tmp_path / "monday.h5", tmp_path / "tuesday.h5"
    out = tmp_path / "both.h5"
    with pytest.raises(FramesDisagree, match=r"tuesday .* than those of monday"):
        run("build", *frames, "-o", out, *FULL)
    run("build", frames[0], "-o", monday, *FULL)
    run("build", frames[1], "-o", tuesday, *FULL, "--keep-basis", monday)
    with pytest.raises(FramesDisagree, match="align: off"):
        run("merge", monday, tuesday, "-o", out)
    assert not out.exists()
    assert "96 scans" in run("merge", monday, tuesday, "-o", out, "--align", "off")
    again = ("-o", out, "--force")
    assert "96 scans" in run("build", *frames, *again, *FULL, "--align", "off")
    with pytest.raises(SystemExit):  # it is there already
        run("merge", monday, tuesday, "-o", out, "--align", "auto")
    for words in (("--computed", "tuesday"), ("--align", "auto")):
        assert "tuesday were turned by" in notes_of("merge", monday, tuesday, *again, *words)
    (placement,) = json.loads(run("inspect", out, "--json"))["placements"].values()
    assert placement["translation_m"][0] == pytest.approx(-500.0, abs=1.0)
    assert "placed  tuesday: turned by" in run("inspect", out)


@needs_odometry
def test_merged_maps_of_odometry_are_the_map_of_both_drives(tmp_path):
    folders = []
    for seed, name in ((1, "north"), (5, "south")):
        sensor = SimulatedSensor(firings=180)
        write_kitti_drive(SimulatedDrive(seed=seed, scans=12, sensor=sensor), tmp_path / name)
        (tmp_path / name / "poses.txt").unlink()
        folders.append(tmp_path / name)
    north, south, merged, whole = (
        tmp_path / f"{name}.h5" for name in ("north", "south", "merged", "whole")
    )
    options = ("--lateral-renderings=-1.5,0,1.5", "--views", "full")
    run("build", folders[0], "-o", north, *options)
    run("build", folders[1], "-o", south, *options, "--keep-basis", north)
    run("build", *folders, "-o", whole, *options, "--keep-basis", north)
    assert "beside the drives that it does not meet" in notes_of(
        *("merge", north, south, "-o", merged)
    )
    found, wanted = read_map(merged), read_map(whole)
    assert found.computed_poses == wanted.computed_poses == ("north", "south")
    assert found.revision == replace(wanted, calibration=None, image_calibration=None).revision


def test_files_that_cannot_be_merged_are_rejected_and_nothing_is_written(maps, folders, tmp_path):
    out = tmp_path / "out.h5"
    run("build", folders[1], "-o", tmp_path / "other.h5", *HARMONIC)
    with pytest.raises(BasisMismatch, match="build it with the first one's basis"):
        run("merge", maps[0], tmp_path / "other.h5", "-o", out)
    with pytest.raises(UnknownDrive, match="none of the maps has a drive 'friday'"):
        run("merge", *maps, "--without", "friday", "-o", out)
    with pytest.raises(EmptyDrive, match="no drive would be left"):
        run("merge", *maps, "--without", "monday", "--without", "tuesday", "-o", out)
    both = tmp_path / "both.h5"
    run("merge", *maps, "-o", both)
    with pytest.raises(InvalidParameters, match=f"leave {maps[0]} out, which has no other drive"):
        run("merge", both, maps[0], "-o", out)
    with pytest.raises(
        InvalidParameters, match=f"'tuesday' is in .*: tensormap merge {both} --without tuesday -o"
    ):
        run("merge", maps[1], both, "-o", out)
    with pytest.raises(InvalidParameters, match="called 'monday': rename"):
        run("build", folders[0], folders[0], "-o", out)
    with pytest.raises(InvalidParameters, match="makes signatures otherwise"):
        run("build", folders[1], "-o", out, *HARMONIC, "--views", "full", "--keep-basis", maps[0])
    run("build", folders[0], "-o", tmp_path / "paper.h5", "--encoding", "paper")
    with pytest.raises(InvalidParameters, match="no basis to keep"):
        run("build", folders[1], "-o", out, *HARMONIC, "--keep-basis", tmp_path / "paper.h5")
    assert not out.exists()
