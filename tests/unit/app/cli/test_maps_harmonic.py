"""The commands, for a harmonic map."""

import json
from dataclasses import replace

import numpy as np
import pytest

from core.confidence.calibration import Calibration
from core.encodings.signature import unpack_signatures
from core.errors import InvalidParameters
from storage.files.map_file import read_map, write_map
from tests.support.commands import called, notes_of, run
from tests.support.recording import kitti, recording

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A drive as scan files, without poses."""
    folder = tmp_path_factory.mktemp("drive")
    for index, scan in enumerate(recording(scans=12).scans):
        (folder / f"{index:06}.bin").write_bytes(kitti(scan))
    return folder


@pytest.fixture(scope="module")
def map_file(folder, tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "map.h5"
    options = ["--lateral-renderings=-1.5,0,1.5", "--segments", "2", "--no-odometry"]
    run("build", folder, "-o", path, *options)
    return path


def test_commands_on_a_drive_of_one_scan_say_one_scan(tmp_path):
    shown = run("simulate", tmp_path / "monday", "--scans", "1")
    shown += run("build", tmp_path / "monday", "-o", tmp_path / "map.h5")
    shown += run("inspect", tmp_path / "map.h5")
    assert shown.count("1 scan of") == 1
    assert "1 scan, 1 segment, " in shown
    assert "2 nodes, 1 edge\n" in shown


def test_inspect_shows_what_it_was_built_with(map_file):
    facts = json.loads(run("inspect", map_file, "--json"))
    assert (facts["encoding"], facts["image"], facts["reducer"]) == (
        "harmonic",
        "height",
        "highest",
    )
    assert facts["lateral_renderings_m"] == [-1.5, 0.0, 1.5]
    assert facts["arrays"]["signature_codes"] == {"shape": [23, 10, 3, 12], "dtype": "int8"}
    assert "harmonic" in run("inspect", map_file)


def test_inspect_counts_verification_images_apart(folder, tmp_path):
    path = tmp_path / "map.h5"
    assert "14400 of verification images" in run("build", folder, "-o", path, "--views", "any")
    facts = json.loads(run("inspect", path, "--json"))
    assert facts["verification_images"] is True
    assert facts["verification_bytes"] == 12 * 20 * 60
    assert facts["arrays"]["verification_images"] == {"shape": [12, 20, 60], "dtype": "uint8"}
    assert "14400 of verification images" in run("inspect", path)
    options = ("--views", "any", "--no-verification-images")
    with pytest.raises(SystemExit):  # it is there already
        run("build", folder, "-o", path, *options)
    assert json.loads(run("inspect", path, "--json")) == facts
    run("build", folder, "-o", path, *options, "--force")
    facts = json.loads(run("inspect", path, "--json"))
    assert facts["verification_bytes"] == 0
    assert "verification_images" not in facts["arrays"]


def test_localize_returns_relative_yaw_and_lateral_offset(map_file, folder):
    scan = folder / "000007.bin"
    answer = json.loads(run("localize", map_file, scan, "--json"))
    best = answer["best"]
    assert best["scan_index"] == 7
    assert best["lateral_m"] == pytest.approx(0.0, abs=0.1)
    assert best["turn_deg"] == pytest.approx(0.0, abs=0.5)
    assert best["estimated_pose"] is None
    assert "turn" in run("localize", map_file, scan)
    mounted = run("localize", map_file, scan, "--sensor-height-m", "3", "--json")
    assert json.loads(mounted)["best"]["distance"] > best["distance"]


@pytest.mark.parametrize(("options", "size"), [([], 99), (["--packing", "float16"], 175)])
def test_a_signature_is_printed_and_packed(map_file, folder, tmp_path, options, size):
    packed = tmp_path / "packed"
    printed = run("signature", map_file, folder / "000003.bin", "--packed", packed, *options)
    [shown] = json.loads(printed)["signatures"]
    [signature] = unpack_signatures(packed.read_bytes())
    assert packed.stat().st_size == size
    largest = np.abs(shown["values_real"]).max()
    np.testing.assert_allclose(
        signature.values.real, shown["values_real"], atol=largest / 125
    )  # half a step


def test_a_vehicle_may_send_other_ranks_of_those_that_are_compared(map_file, folder, tmp_path):
    packed, scan = tmp_path / "packed", folder / "000003.bin"
    run("signature", map_file, scan, "--packed", packed, "--ranks", "5,5")
    assert packed.stat().st_size == 66
    run("signature", map_file, scan, "--packed", packed, "--ranks", "10,12")
    assert packed.stat().st_size == 251
    for ranks in ("11,5", "2,7"):
        with pytest.raises(InvalidParameters, match="this map takes 3 x 3 to 10 x 12"):
            run("signature", map_file, scan, "--ranks", ranks)
    whole = tmp_path / "whole.h5"
    run("build", folder, "-o", whole, "--views", "full")
    with pytest.raises(InvalidParameters, match="ranks are 6 x 7, this map takes 5 x 5"):
        run("signature", whole, scan, "--ranks", "6,7")


def test_a_signature_of_too_few_cells_comes_with_a_warning(map_file, folder, tmp_path):
    packed, scan = tmp_path / "packed", folder / "000003.bin"
    wanting = Calibration(0.1, (0.0, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0), least_cells=4000)
    write_map(tmp_path / "wanting.h5", replace(read_map(map_file), calibration=wanting))
    written = called("signature", tmp_path / "wanting.h5", scan, "--packed", packed)
    assert "occupied, the map wants at least 4000: do not send this" in written
    assert packed.stat().st_size == 99
    assert "too few" not in called("signature", map_file, scan)


def test_a_segment_of_a_harmonic_signature_is_rejected(map_file, folder):
    with pytest.raises(InvalidParameters, match="leave --segment out"):
        run("signature", map_file, folder / "000003.bin", "--segment", "0")


def test_options_of_the_other_encoding_are_rejected(folder, tmp_path):
    out = tmp_path / "map.h5"
    with pytest.raises(InvalidParameters, match="distance"):
        run("build", folder, "-o", out, "--encoding", "paper", "--distance", "plain")


def test_a_reducer_that_only_the_papers_encoding_has_chooses_it(folder, tmp_path):
    run("build", folder, "-o", tmp_path / "map.h5", "--reducer", "nearest", "--segments", "2")
    assert json.loads(run("inspect", tmp_path / "map.h5", "--json"))["encoding"] == "paper"


def test_a_build_reports_that_it_is_not_calibrated_and_then_has_no_probability(folder, tmp_path):
    path = tmp_path / "map.h5"
    words = ("build", folder, "-o", path, "--segments", "2")
    assert "tensormap: too few scans for a calibration" in notes_of(*words)
    assert "too few scans" not in run(*words, "--force")
    scan = folder / "000007.bin"
    answer = json.loads(run("localize", path, scan, "--json"))
    assert (answer["localized"], answer["probability"]) == (True, None)
    required = json.loads(run("localize", path, scan, "--min-probability", "0.5", "--json"))
    assert (required["localized"], required["reason"]) == (False, "not_calibrated")
    shown = run("localize", path, scan, "--min-probability", "0.5")
    assert "000007.bin is not localized: not_calibrated" in shown


def test_localize_takes_priors(map_file, folder):
    scan = folder / "000007.bin"
    answer = json.loads(run("localize", map_file, scan, "-k", "3", "--segment", "0", "--json"))
    assert {match["segment"] for match in answer["matches"]} == {0}
    with pytest.raises(InvalidParameters, match="no poses"):
        run("localize", map_file, scan, *["--x-m", "1", "--y-m", "2", "--position-sigma-m", "3"])
    with pytest.raises(InvalidParameters, match=r"it lacks y_m, position_sigma_m$"):
        run("localize", map_file, scan, "--x-m", "1")
