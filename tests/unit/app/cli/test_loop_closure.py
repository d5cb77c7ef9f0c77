"""`tensormap loop-closure`: which pairs it checks, and how it reports the others."""

import json
from pathlib import Path
from typing import Any

import pytest

from core.errors import InvalidParameters
from tests.support.commands import called, run
from tests.support.recording import kitti, recording

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of 26 scans, of which one cannot be used."""
    folder = tmp_path_factory.mktemp("drives") / "monday"
    folder.mkdir()
    for index, scan in enumerate(recording().scans[:26]):
        (folder / f"{index:06}.bin").write_bytes(kitti(scan))
    (folder / "000005.bin").write_bytes(b"cut off")
    return folder


def _answers(shown: str) -> list[tuple[Any, Any]]:
    answers = [json.loads(line) for line in shown.splitlines() if line.startswith("{")]
    return [(answer["query"], answer["verdict"]) for answer in answers]


def test_pairs_of_scans_are_checked(drive) -> None:
    shown = run("loop-closure", drive, "3,3", "3,25")
    assert ("accepted" in shown, "rejected" in shown) == (True, True)


def test_answers_of_a_command_in_a_terminal_go_where_its_output_does(drive, monkeypatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # as if standard error were one
    shown = run("loop-closure", drive, "3,3", "3,25", "--json")
    assert _answers(shown) == [
        ("monday 3, monday 3", "accepted"),
        ("monday 3, monday 25", "rejected"),
    ]


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_a_scan_that_cannot_be_used_does_not_hide_the_pairs_after_it(drive, options) -> None:
    shown = called("loop-closure", drive, "3,5", "3,3", *options, status=1, COLUMNS="160")
    assert "accepted" in shown
    assert "tensormap: monday 3, monday 5: " in shown
    assert "000005.bin" in shown


def test_scans_of_two_drives_of_one_name_are_named_by_paths(drive, tmp_path) -> None:
    (tmp_path / "monday").symlink_to(drive)
    words = ("loop-closure", drive, "3,3", "--second-drive", tmp_path / "monday", "--json")
    assert _answers(run(*words)) == [(f"{drive} 3, {tmp_path / 'monday'} 3", "accepted")]


def test_scans_that_are_not_there_are_found_before_the_work(drive) -> None:
    shown = called("loop-closure", drive, "3,3", "3,26", status=1)
    assert "no scan 26, it has 0..25" in shown
    assert "accepted" not in shown


@pytest.mark.parametrize("wrong", ["3", "3,x", "a,3"])
def test_what_is_no_pair_of_scans_is_rejected(drive, wrong) -> None:
    with pytest.raises(InvalidParameters, match="no pair of scans"):
        run("loop-closure", drive, wrong)
