"""Which scans `tensormap localize` and `where` query with, and how their answers are shown."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.cli.queries import answers_to
from core.errors import InvalidParameters, InvalidScan
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from tests.support.bags import cloud, record_bag
from tests.support.captures import hdl32, pcap, udp
from tests.support.commands import called, notes_of, run
from tests.support.recording import kitti

DRIVE = SimulatedDrive(seed=33, scans=8, stops=False, sensor=SimulatedSensor(firings=180))


@pytest.fixture(scope="module")
def district(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two folders of scans, of which one cannot be used, a bag, and a map."""
    folder = tmp_path_factory.mktemp("district")
    for day in ("monday", "tuesday"):
        (folder / day).mkdir()
        for index, scan in enumerate(DRIVE):
            (folder / day / f"{index:06}.bin").write_bytes(kitti(scan))
    options = ["--lateral-renderings=0", "--segments", "2", "--no-odometry"]
    run("build", folder / "monday", "-o", folder / "map.h5", *options)
    (folder / "tuesday" / "000003.bin").write_bytes(bytes(17))
    clouds = [cloud(DRIVE.scan(index).points_m, lines=1) for index in range(4)]
    record_bag(folder / "bag", clouds, topics=("/front", "/rear"))
    return folder


def _answers(command: str, district: Path, *words: object, status: int = 0) -> list[Any]:
    map_file = district / "map.h5"
    maps = [map_file] if command == "localize" else ["--map", map_file]
    shown = called(command, *maps, *map(str, words), "--json", status=status)
    return [json.loads(line) for line in shown.splitlines() if line.startswith("{")]


@pytest.mark.parametrize("command", ["localize", "where"])
def test_an_answer_in_json_names_its_scan_also_where_scans_before_it_are_unusable(
    district, command
) -> None:
    answers = _answers(command, district, district / "tuesday", status=1)
    assert [answer["query"] for answer in answers] == [
        f"tuesday {i}" for i in (0, 1, 2, 4, 5, 6, 7)
    ]
    assert [answer["best"]["scan_index"] for answer in answers] == [0, 1, 2, 4, 5, 6, 7]


def test_an_answer_in_json_is_written_before_the_next_query_begins() -> None:
    happened: list[str] = []

    def answer(number: int) -> int:
        happened.append(f"query {number}")
        if number == 1:
            raise InvalidScan("it is empty")
        return 10 * number

    def write(name: str, found: int) -> None:
        happened.append(f"{name}: {found}")

    queries = [(name, number) for number, name in enumerate("abc")]
    assert answers_to(queries, answer, write) == ([], ["b: it is empty"])
    assert happened == ["query 0", "a: 0", "query 1", "query 2", "c: 20"]


def test_scan_files_of_one_name_are_named_by_their_paths(district) -> None:
    twice = [district / day / "000002.bin" for day in ("monday", "tuesday")]
    answers = _answers("localize", district, *twice, district / "monday/000005.bin")
    assert [answer["query"] for answer in answers] == [*map(str, twice), "000005.bin"]


@pytest.mark.parametrize("command", ["localize", "where"])
def test_the_clouds_of_a_bag_are_localized_as_they_are_mapped(district, command) -> None:
    answers = _answers(command, district, district / "bag#/rear")
    assert [answer["best"]["scan_index"] for answer in answers] == [0, 1, 2, 3]
    assert answers[3]["query"] == "bag 3"
    topics = [district / f"bag#/{topic}" for topic in ("front", "rear")]
    named = [answer["query"] for answer in _answers(command, district, *topics)]
    assert named == [f"{topic} {index}" for topic in topics for index in range(4)]


def test_a_bag_that_is_not_there_is_named_without_its_topic(district, tmp_path) -> None:
    shown = called("localize", district / "map.h5", tmp_path / "none.bag#/rear", status=1)
    assert "tensormap: none.bag: No such file or directory" in shown


def test_each_revolution_of_a_capture_is_localized_and_the_first_with_its_format(
    district, tmp_path
) -> None:
    capture, cut, alone = tmp_path / "a.pcap", tmp_path / "cut.pcap", tmp_path / "alone.pcap"
    for file, turns in ((capture, 3.2), (alone, 0.5)):
        frames = [frame for payload in hdl32(turns=turns) for frame in udp(payload, 2368)]
        file.write_bytes(pcap(frames))
    cut.write_bytes(capture.read_bytes()[:1000])
    answers = _answers("localize", district, capture)
    assert [answer["query"] for answer in answers] == ["a 0", "a 1", "a 2"]
    assert len(_answers("where", district, capture)) == 3
    first = _answers("localize", district, capture, "--format", "velodyne")
    assert [answer["query"] for answer in first] == ["a.pcap"]
    assert first[0]["best"]["distance"] == pytest.approx(answers[0]["best"]["distance"])
    # One that cannot be used is reported as a scan file is, and the others are answered.
    good = district / "monday/000001.bin"
    assert len(_answers("localize", district, cut, alone, good, status=1)) == 1


def test_drives_of_one_name_are_named_by_their_paths_whatever_their_files_are_named(
    district, tmp_path
) -> None:
    folder, capture = tmp_path / "monday", tmp_path / "monday.pcap"
    folder.symlink_to(district / "bag")  # as a bag it has the name of its link
    frames = [frame for payload in hdl32(turns=1.2) for frame in udp(payload, 2368)]
    capture.write_bytes(pcap(frames))
    answers = _answers("localize", district, capture, f"{folder}#/rear")
    assert [answer["query"] for answer in answers] == [
        f"{capture} 0",
        *(f"{folder}#/rear {index}" for index in range(4)),
    ]


def test_a_format_is_rejected_for_a_drive_whose_layout_says_it(district) -> None:
    with pytest.raises(InvalidParameters, match=r"--format is of scan files, .*monday is a drive"):
        run("localize", district / "map.h5", district / "monday", "--format", "nclt")


def test_a_file_of_an_unknown_suffix_is_answered_with_the_option_that_names_its_format(
    district, tmp_path
) -> None:
    recorded = tmp_path / "scan.dat"
    recorded.write_bytes(kitti(DRIVE.scan(4)))
    shown = called("localize", district / "map.h5", recorded, status=1)
    assert "scan.dat: its name does not say its format; wanted --format with one of kitti" in shown
    assert "Content-Type" not in shown
    answers = _answers("localize", district, recorded, "--format", "kitti")
    assert answers[0]["best"]["scan_index"] == 4


def test_several_arrays_in_a_file_are_answered_with_what_to_save(district, tmp_path) -> None:
    np.savez(tmp_path / "scan.npz", points=DRIVE.scan(4).points_m)
    shown = called("localize", district / "map.h5", tmp_path / "scan.npz", status=1)
    assert "scan.npz may hold several arrays: save one as .npy, by numpy.save" in shown


@pytest.mark.parametrize("command", ["localize", "where"])
def test_ratio_and_probability_are_in_the_row_of_the_best_match_only(
    district, command, monkeypatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    map_file = district / "map.h5"
    maps = [map_file] if command == "localize" else ["--map", map_file]
    shown = run(command, *maps, district / "monday/000004.bin", "-k", 2)
    rows = [line.split("│") for line in shown.splitlines() if "000004.bin" in line]
    ratios, probable = zip(*([cell.strip() for cell in row[-3:-1]] for row in rows), strict=True)
    assert ratios[0]
    assert probable[0]
    assert (ratios[1], probable[1]) == ("", "")


@pytest.mark.parametrize("command", ["localize", "where"])
def test_scans_that_are_not_localized_are_noted_if_another_axis_is_up(
    district, tmp_path, command
) -> None:
    for index in range(3):
        turned = kitti(Scan.from_returns(DRIVE.scan(index).points_m * [1, -1, -1]))
        (tmp_path / f"{index}.bin").write_bytes(turned)
    # A map of few scans is not calibrated, and refuses nothing else.
    refusing = ("--min-probability", "0.5")
    wrong = [tmp_path / f"{index}.bin" for index in range(3)]
    right = district / "monday" / "000002.bin"
    answers = _answers(command, district, *wrong, right, *refusing)
    assert [len(answer["notes"]) for answer in answers] == [1, 1, 1, 0]
    localized = _answers(command, district, *wrong)
    assert {(answer["localized"], *answer["notes"]) for answer in localized} == {(True,)}
    mounted = _answers(command, district, *wrong, "--mounting=0,0,1.73,180,0,0", *refusing)
    assert [answer["notes"] for answer in mounted] == [[]] * 3
    map_file = district / "map.h5"
    maps = [map_file] if command == "localize" else ["--map", map_file]
    shown = notes_of(command, *maps, *wrong, right, *refusing)
    assert shown.count("points up") == 1
    assert "tensormap: 3 of 4 scans: the ground seems not to be below the sensor: -z" in shown
