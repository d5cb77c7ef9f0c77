"""Files that commands write."""

import errno
import json
import os
import re
import shutil
import stat
import threading
from importlib import import_module
from pathlib import Path

import pytest
import typer

from app.cli.output_files import is_stream, require_folder, written
from core.mapping.tensormap import TensorMap
from storage.errors import StorageFull
from storage.files.map_file import read_map, write_map
from tests.support.commands import called


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    """A named pipe, which a file that is renamed to its name would replace."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    return path


def _is_pipe(path: Path) -> bool:
    return stat.S_ISFIFO(path.stat().st_mode)


def _read_of(pipe: Path) -> tuple[list[str], threading.Thread]:
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()), daemon=True)
    reader.start()
    return read, reader


def test_figures_go_through_a_pipe_and_do_not_replace_it(pipe, tmp_path) -> None:
    called("simulate", tmp_path / "monday", "--scans", "10")
    read, reader = _read_of(pipe)
    called("evaluate", tmp_path / "monday", "--segments", "2", "--json", pipe)
    assert _is_pipe(pipe)
    reader.join(10)
    assert json.loads(read[0])["drive"] == "monday"


@pytest.mark.parametrize("words", [("build", "monday"), ("merge", "map.h5"), ("report", "monday")])
def test_a_map_or_page_is_not_written_to_a_pipe(pipe, tmp_path, monkeypatch, words) -> None:
    monkeypatch.chdir(tmp_path)
    force = [] if words[0] == "report" else ["--force"]
    shown = called(*words, "-o", "pipe", *force, status=2)
    assert "pipe is a device or pipe" in shown
    assert _is_pipe(pipe)


@pytest.mark.parametrize("path", ["monday.h5", "monday.h5/drive"])
def test_a_folder_is_not_written_where_a_file_is(tmp_path, monkeypatch, path) -> None:
    monkeypatch.chdir(tmp_path)
    Path("monday.h5").write_text("a map")
    shown = called("simulate", path, status=2, COLUMNS="300")
    assert "monday.h5 is a file, wanted a folder" in shown


@pytest.mark.parametrize("path", ["/dev/null", "/dev/stdout", "/dev/fd/1"])
def test_devices_are_streams(path) -> None:
    assert is_stream(Path(path))
    with pytest.raises(typer.BadParameter, match="device"):
        require_folder(Path(path))


def test_files_folders_and_what_is_not_there_are_no_streams(tmp_path) -> None:
    (tmp_path / "old").touch()
    assert not any(map(is_stream, (tmp_path, tmp_path / "old", tmp_path / "new")))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    """A folder with a drive and its map."""
    folder: Path = tmp_path_factory.mktemp("recorded")
    called("simulate", folder / "monday", "--scans", "3")
    called("build", folder / "monday", "-o", folder / "monday.h5")
    return folder


_NEW_MAPS = [("build", "monday"), ("merge", "monday.h5")]


@pytest.mark.parametrize("words", _NEW_MAPS)
def test_of_two_commands_that_write_one_new_file_the_second_is_refused(
    recorded, tmp_path, monkeypatch, words
) -> None:
    path = tmp_path / "map.h5"

    def written_late(part: Path, tensor_map: TensorMap) -> None:
        write_map(part, tensor_map)
        path.write_text("the map of the first")

    monkeypatch.chdir(recorded)
    module = import_module(f"app.cli.{'maps' if words[0] == 'build' else 'merge'}")
    monkeypatch.setattr(module, "write_map", written_late)
    shown = called(*words, "-o", path, status=2, COLUMNS="200")
    assert f"{path} is there already; --force replaces it" in shown
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [
        ("map.h5", "the map of the first")
    ]
    called(*words, "-o", path, "--force")
    assert read_map(path)


@pytest.mark.parametrize("words", _NEW_MAPS)
def test_a_link_that_leads_nowhere_is_there_and_refused_before_the_work(
    recorded, tmp_path, monkeypatch, words
) -> None:
    monkeypatch.chdir(recorded)
    (tmp_path / "map.h5").symlink_to("nowhere")
    shown = called(*words, "-o", tmp_path / "map.h5", status=2, COLUMNS="200")
    assert "map.h5 is there already; --force replaces it" in shown
    assert "projecting" not in shown


@pytest.mark.parametrize(
    "words",
    [(*words, "-o") for words in _NEW_MAPS]
    + [("signature", "monday.h5", "monday/velodyne/000000.bin", "--packed")]
    + [("simulate", "--scans", "1")],
)
def test_the_longest_name_that_a_file_or_folder_may_have_can_be_written(
    recorded, tmp_path, monkeypatch, words
) -> None:
    monkeypatch.chdir(recorded)
    called(*words, tmp_path / ("m" * 255))
    assert [path.name for path in tmp_path.iterdir()] == ["m" * 255]
    shown = called(*words, tmp_path / ("m" * 256), status=1)
    assert "File name too long" in shown
    assert "projecting" not in shown


@pytest.fixture
def inputs(recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with a map, a scan, a link to the scan, and a recording in one file."""
    shutil.copy(recorded / "monday.h5", tmp_path / "map.h5")
    shutil.copy(recorded / "monday/velodyne/000000.bin", tmp_path / "scan.bin")
    (tmp_path / "link.bin").symlink_to("scan.bin")
    (tmp_path / "monday.bag").write_bytes(b"a recording")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "line",
    [
        "signature map.h5 scan.bin --packed scan.bin",
        "signature map.h5 scan.bin --packed ./map.h5",
        "signature map.h5 link.bin --packed scan.bin",
        "evaluate monday.bag --json monday.bag",
        "evaluate monday --unknown monday.bag#/points --json monday.bag",
        "compare monday --query-drive monday.bag --json monday.bag",
        "report monday.bag -o monday.bag",
        "report monday.bag -o page.html --json monday.bag",
        "report monday -o page.html --json page.html",
        "report monday -o page.html --json ../{here}/page.html",
        "report monday -o map.h5 --json ./map.h5",
    ],
)
def test_a_result_does_not_replace_what_it_is_made_of(inputs, line) -> None:
    before = {path.name: path.read_bytes() for path in inputs.iterdir()}
    shown = called(*line.format(here=inputs.name).split(), status=2, COLUMNS="300")
    assert re.search(
        r"cannot be replaced, the command also reads or writes it.*: wanted another", shown
    )
    assert {path.name: path.read_bytes() for path in inputs.iterdir()} == before


def _half_written(part: Path) -> None:
    part.write_text("ne")
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_file_is_as_before_until_the_new_one_is_complete(tmp_path) -> None:
    path = tmp_path / "where.sig"
    path.write_text("old")
    with pytest.raises(StorageFull), written(path) as part:
        _half_written(part)
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]
    with written(path) as part:
        part.write_text("new")
    assert [file.read_text() for file in tmp_path.iterdir()] == ["new"]


def test_a_full_device_is_a_named_error() -> None:
    with pytest.raises(StorageFull), written(Path("/dev/full")) as part:
        part.write_text("figures")
