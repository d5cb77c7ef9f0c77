"""Files that commands write."""

import errno
import os
import stat
import threading
from pathlib import Path

import pytest
import typer

from app.cli.output_files import is_stream, require_folder, written
from storage.errors import StorageFull
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
    assert read[0].startswith('{\n  "drive": "monday"')


@pytest.mark.parametrize("words", [("build", "monday"), ("merge", "map.h5"), ("report", "monday")])
def test_a_map_or_page_is_not_written_to_a_pipe(pipe, tmp_path, monkeypatch, words) -> None:
    monkeypatch.chdir(tmp_path)
    force = [] if words[0] == "report" else ["--force"]
    shown = called(*words, "-o", "pipe", *force, status=2)
    assert "pipe is a device or pipe" in shown
    assert _is_pipe(pipe)


@pytest.mark.parametrize("path", ["/dev/null", "/dev/stdout", "/dev/fd/1"])
def test_devices_are_streams(path) -> None:
    assert is_stream(Path(path))
    with pytest.raises(typer.BadParameter, match="device"):
        require_folder(Path(path))


def test_files_folders_and_what_is_not_there_are_no_streams(tmp_path) -> None:
    (tmp_path / "old").touch()
    assert not any(map(is_stream, (tmp_path, tmp_path / "old", tmp_path / "new")))


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


def test_a_full_device_is_a_named_error(tmp_path) -> None:
    with pytest.raises(StorageFull), written(Path("/dev/full")) as part:
        part.write_text("figures")
