"""The command line. Those that serve are processes, and the documents run each command as one."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.support.commands import called, tensormap
from tests.support.process import until


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives") / "monday"
    called("simulate", folder, "--scans", "20", "--seed", "12")
    return folder


@pytest.fixture(scope="module")
def map_file(drive: Path) -> Path:
    path = drive.parent / "monday.h5"
    shown = called("build", drive, "-o", path, "--segments", "2", "--reducer", "nearest")
    assert "20 scans, 2 segments, map : images : returns = 1 : " in shown
    return path


def test_a_map_is_inspected(map_file: Path) -> None:
    facts = json.loads(called("inspect", map_file, "--json"))
    assert (facts["scans"], facts["segments"], facts["reducer"]) == (20, 2, "nearest")
    assert facts["arrays"]["signatures"] == {"shape": [20, 5, 5], "dtype": "float32"}
    assert facts["revision"][:12] in called("inspect", map_file)


def test_a_scan_is_localized_where_it_was_taken(map_file: Path, drive: Path) -> None:
    scans = [drive / "velodyne" / f"{index:06d}.bin" for index in (3, 16)]
    shown = called("localize", map_file, *scans, "-k", "2", "--json")
    answers = [json.loads(line) for line in shown.splitlines() if line.startswith("{")]
    assert [answer["best"]["scan_index"] for answer in answers] == [3, 16]
    assert [answer["best"]["segment"] for answer in answers] == [0, 1]
    assert all(len(answer["matches"]) == 2 for answer in answers)


def test_a_signature_is_printed_and_packed(map_file: Path, drive: Path, tmp_path: Path) -> None:
    scan = drive / "velodyne" / "000003.bin"
    packed = tmp_path / "where.sig"
    shown = called("signature", map_file, scan, "--segment", "1", "--packed", packed)
    body = json.loads(shown)
    assert [item["segment"] for item in body["signatures"]] == [1]
    assert [len(row) for row in body["signatures"][0]["values"]] == [5] * 5
    assert len(packed.read_bytes()) == 63
    assert len(json.loads(called("signature", map_file, scan))["signatures"]) == 2


def test_evaluate_writes_every_figure(drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "figures.json"
    lists = ["--yaw-deg", "0,-90", "--lateral-m", "-1,1", "--noise-m", "0,0.1"]
    called("evaluate", drive, "--segments", "2", *lists, "--tolerance-m", "2.5", "--json", out)
    found = json.loads(out.read_text())
    assert found["drive"] == "monday"
    assert (found["encoding"], found["ranks"], found["reducer"]) == ("harmonic", [6, 7], "highest")
    assert (found["segments"], found["sensor"], found["seed"]) == (2, "hdl-64e", 0)
    assert found["sensor_height_m"] == 1.73
    assert set(found["compression"]) == {
        "elements", "tensor_ratio", "returns_ratio", "verification_bytes"
    }  # fmt: skip
    assert len(found["relative_error"]) == 2
    assert [(row["yaw_deg"], row["lateral_m"], row["noise_m"]) for row in found["conditions"]] == [
        (y, d, n) for y in (0, -90) for d in (-1, 1) for n in (0, 0.1)
    ]
    assert set(found["conditions"][0]) >= {
        "queries",
        "segment_accuracy",
        "errors",
        "errors_moving",
        "errors_stationary",
        "recall_at_1",
        "position_error_m_median",
        "heading_error_deg_median",
        "ms_per_query",
    }
    assert set(found["conditions"][0]["recall_at_1"]) == {"2.5"}
    assert found["conditions"][0]["queries"] == 4


def test_evaluate_queries_with_a_second_drive(drive: Path, tmp_path: Path) -> None:
    second, out = tmp_path / "tuesday", tmp_path / "figures.json"
    called("simulate", second, "--scans", "20", "--seed", "12", "--lateral-m", "1")
    called("evaluate", drive, "--query-drive", second, "--segments", "2", "--json", out)
    found = json.loads(out.read_text())
    assert (found["drive"], found["query_drive"], found["split"]) == ("monday", "tuesday", None)
    assert found["conditions"][0]["queries"] == 20


def test_the_demonstration_ends_by_itself_with_once(drive: Path) -> None:
    shown = tensormap("demo", "--once", "--drive", drive, "--port", "8300")
    stages = re.findall(r"^(\w+): (\d+) of \2$", shown, re.M)
    assert stages[0] == ("starting", "1")
    assert ("recording", "4") in stages
    assert "full scan" in shown
    assert "60" in shown


def test_a_demonstration_that_is_terminated_ends_its_service_and_removes_its_data(
    drive: Path, tmp_path: Path
) -> None:
    words = [sys.executable, "-m", "app.cli", "demo", "--drive", str(drive), "--port", "8300"]
    settings = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(words, stderr=subprocess.PIPE, env=settings) as command:
        try:
            until(lambda: any(tmp_path.glob("*/data/catalog.sqlite3")), "the service has no data")
            command.terminate()
            _, shown = command.communicate(timeout=30)
        finally:
            command.kill()
    assert (command.returncode, shown.splitlines()[-1]) == (143, b"tensormap: stopped")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (["evaluate", "{drive}", "--segments", "2", "--segment-length", "9"], 1, "not both"),
        (["evaluate", "{drive}", "--ranks", "5"], 2, "r1,r2"),
        (["evaluate", "{drive}", "--ranks", "21,5"], 1, "r1 is 21, wanted 1..20"),
        (["evaluate", "{drive}", "--split", "half"], 1, "every:N"),
        (["evaluate", "{drive}", "--yaw-deg", "0,east"], 2, "'0,east'"),
        (["evaluate", "{drive}", "--noise-m", "-1"], 1, "wanted at least 0"),
        (["evaluate", "{drive}", "--sensor", "eyes"], 1, "hdl-64e"),
        (["evaluate", "{drive}", "--query-drive", "{drive}", "--split", "every:2"], 1, "--split"),
        (["evaluate", "{folder}/nowhere"], 1, "nowhere; wanted a folder"),
        (["build", "{folder}", "-o", "{folder}/x.h5"], 1, "velodyne"),
        (["build", "{drive}", "-o", "{folder}/no/such/x.h5"], 2, "there is no folder"),
        (["evaluate", "{drive}", "--json", "{folder}/no/such/x.json"], 2, "there is no folder"),
        (["inspect", "{folder}/nowhere.h5"], 1, "nowhere.h5"),
        (["inspect", "{drive}/times.txt"], 1, "cannot be read as a map"),
        (["localize", "{map}", "{drive}/times.txt"], 1, "times.txt"),
        (["signature", "{map}", "{drive}/velodyne/000003.bin", "--segment", "7"], 1, "0..1"),
        (["serve", "--port", "70000"], 2, "65535"),
        (["restore", "{drive}/times.txt", "--data", "{folder}/new"], 1, "is no backup"),
        (["restore", "{folder}/nowhere.tar", "--data", "{folder}/new"], 1, "No such file"),
        (["restore", "{drive}/times.txt", "--data", "{drive}"], 1, "is there already"),
        (["backup", "--data", "{folder}", "-o", "{folder}/b.tar"], 1, "it has no catalog.sqlite3"),
        (["backup", "--data", "{folder}", "-o", "{folder}/no/b.tar"], 2, "there is no folder"),
    ],
)
def test_an_invalid_option_is_reported_in_a_line(
    words: list[str],
    status: int,
    message: str,
    drive: Path,
    map_file: Path,
    tmp_path: Path,
) -> None:
    places = {"drive": drive, "map": map_file, "folder": tmp_path}
    given = [word.format(**places) for word in words]
    assert message in " ".join(called(*given, status=status, COLUMNS="300").split())


def test_a_catalog_elsewhere_is_not_backed_up_as_if_it_were_here(tmp_path: Path) -> None:
    url = "postgresql+psycopg://user:secret@127.0.0.1/maps"
    shown = called("backup", "-o", tmp_path / "b.tar", status=1, TENSORMAP_CATALOG_URL=url)
    assert "pg_dump" in shown
    assert "secret" not in shown
    assert list(tmp_path.iterdir()) == []


def test_one_scan_that_cannot_be_used_does_not_hide_the_others(
    map_file: Path, drive: Path, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.bin"
    cut.write_bytes(bytes(17))
    good = drive / "velodyne" / "000003.bin"
    shown = called("localize", map_file, cut, good, "--json", status=1)
    assert '"scan_index":3' in shown
    assert "cut.bin: the body has 17 bytes" in shown
    upwards = tmp_path / "upwards.bin"
    np.tile(np.array([0.1, 0.0, 50.0, 1.0], "<f4"), (500, 1)).tofile(upwards)
    shown = called("localize", map_file, upwards, good, "--json", status=1)
    assert '"scan_index":3' in shown
    assert "upwards.bin: none of the " in shown


def test_a_scan_that_cannot_be_opened_is_reported_and_the_others_are_answered(
    map_file: Path, drive: Path, tmp_path: Path
) -> None:
    good, gone = drive / "velodyne/000003.bin", tmp_path / "gone.bin"
    shown = called("localize", map_file, good, gone, good, "--json", status=1)
    assert shown.count('"scan_index":3') >= 2
    assert "tensormap: gone.bin: No such file or directory" in shown


def test_a_demonstration_of_too_few_scans_is_an_error(tmp_path: Path) -> None:
    short = tmp_path / "short"
    called("simulate", short, "--scans", "2")
    shown = tensormap("demo", "--once", "--drive", short, "--port", "8300", status=1)
    assert "too few" in shown


def test_a_damaged_map_is_refused(map_file: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(map_file.read_bytes())
    with h5py.File(damaged, "r+") as file:
        file["signatures"][0, 0, 0] += 1
    assert "its content is" in called("inspect", damaged, status=1)


def test_a_command_shows_why_the_catalog_cannot_be_used(tmp_path: Path) -> None:
    (tmp_path / "catalog.sqlite3").write_bytes(b"no database at all" * 1000)
    failed = called("audit", "verify", "--data", tmp_path, status=1)
    assert "the catalog's database fails or cannot be reached" in failed
    assert "file is not a database" in failed
