import os
import re
import signal
import subprocess
import sys
import time
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import cast

import pytest
import typer
from typer.testing import CliRunner

from app.cli.main import _MODULES, cli, imported
from core.scans.scan import Scan
from storage.files.map_file import read_map
from storage.store import Store
from tests.support.commands import HEEDING_STOPS, PROGRAM, called, run


@pytest.mark.parametrize("name", _MODULES)
def test_the_list_of_commands_describes_each_as_its_own_help_does(name) -> None:
    group = cast("typer.core.TyperGroup", typer.main.get_command(cli))
    assert name in group.list_commands(typer.Context(group))
    listed = group.commands[name].help
    assert listed
    assert listed.split() == imported(name).help.split()


def test_a_command_starts_without_the_descriptions_of_all_others(monkeypatch) -> None:
    described: list[str] = []
    monkeypatch.setattr(import_module("app.cli.main"), "_described", described.append)
    assert CliRunner().invoke(cli, ["inspect", "--help"]).exit_code == 0
    assert not described


@pytest.mark.parametrize(
    ("words", "default"),
    [
        (["build"], "[last; harmonic: highest, of ranges mean]"),
        (["build"], "[k fits the longest drive, at most 760]"),
        (["evaluate"], "Of fixed segments turns add none. [k = 760]"),
        (["evaluate"], "[any in harmonic maps of heights, else full]"),
        (["localize"], "[the map's threshold]"),
        (["audit", "verify"], "[data]"),
    ],
)
def test_the_help_of_an_option_shows_its_default_in_brackets(words, default) -> None:
    shown = CliRunner().invoke(cli, [*words, "--help"], env={"COLUMNS": "200"}).output
    assert default in " ".join(shown.split())


@pytest.mark.parametrize("columns", [44, 60, 70, 80, 140, 200])
@pytest.mark.parametrize(
    "name", [name for name in _MODULES if name not in {"audit", "recycle-bin"}]
)
def test_the_help_of_a_command_shows_whole_names_of_options(name, columns) -> None:
    shown = CliRunner().invoke(cli, [name, "--help"], env={"COLUMNS": str(columns)}).output
    assert {name for parameter in imported(name).params for name in _options_of(parameter)} <= set(
        shown.replace(",", " ").split()
    )
    # In fewer columns the form of a value may be cut.
    assert columns < 80 or not {"…", "\\"} & set(shown)


@pytest.mark.parametrize("columns", [60, 80])
@pytest.mark.parametrize(
    "words",
    [[name] for name in _MODULES]
    + [["audit", "verify"]]
    + [["recycle-bin", command] for command in ("list", "restore", "purge")],
)
def test_the_description_of_a_command_fills_its_lines_at_any_width(words, columns) -> None:
    shown = CliRunner().invoke(cli, [*words, "--help"], env={"COLUMNS": str(columns)}).output
    description = re.split("╭|Arguments:|Options:", shown)[0]
    lines = [line.strip() for line in description.splitlines()]
    assert len([line for line in lines if line]) > 1
    for line, following in pairwise(lines):
        if line and following:
            # Two columns are the margins; the break must be where the next word does not fit.
            assert len(f"{line} {following.split()[0]}") > columns - 2


def _options_of(parameter: typer.core.TyperOption) -> list[str]:
    return [name for name in (*parameter.opts, *parameter.secondary_opts) if name.startswith("-")]


@pytest.mark.parametrize(
    "words",
    [["backup"], ["verify"], ["audit", "verify"]]
    + [["recycle-bin", command] for command in ("list", "restore", "purge")],
)
def test_the_help_of_a_command_on_a_data_directory_names_its_variable(words) -> None:
    shown = CliRunner().invoke(cli, [*words, "--help"], env={"COLUMNS": "200"}).output
    assert "TENSORMAP_DATA_DIR" in shown


def _printed(program: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()[-1]


_RUN = "import sys; from app.cli.main import cli, imported; sys.argv[1:] = {words}; "


def test_the_list_of_commands_imports_no_library_that_computes() -> None:
    words = "; cli(standalone_mode=False); print(sorted({'numpy', 'fastapi'} & set(sys.modules)))"
    assert _printed(_RUN.format(words=["--help"]).rstrip("; ") + words) == "[]"


def test_commands_on_files_import_nothing_of_the_service() -> None:
    # A second of the start of a command that takes half of one.
    commands = "[imported(name) for name in ('localize', 'signature', 'where', 'inspect')]"
    heavy = "{'fastapi', 'sqlalchemy', 'scipy'}"
    program = f"{commands}; print(sorted({heavy} & set(sys.modules)))"
    assert _printed(_RUN.format(words=[]) + program) == "[]"


def test_commands_on_a_data_directory_do_not_import_the_web_framework() -> None:
    commands = (
        "[imported(name) for name in ('verify', 'backup', 'restore', 'audit', 'recycle-bin')]"
    )
    program = f"{commands}; print(sorted({{'fastapi', 'starlette.routing'}} & set(sys.modules)))"
    assert _printed(_RUN.format(words=[]) + program) == "[]"


def test_a_build_without_a_service_imports_no_database(tmp_path) -> None:
    # Half a second, where building twenty scans takes one.
    drive, file = str(tmp_path / "monday"), str(tmp_path / "map.h5")
    program = "; ".join(
        [
            f"imported('simulate')([{drive!r}, '--scans', '4'], standalone_mode=False)",
            f"imported('build')([{drive!r}, '-o', {file!r}], standalone_mode=False)",
            "print(sorted({'fastapi', 'sqlalchemy'} & set(sys.modules)))",
        ]
    )
    assert _printed(_RUN.format(words=[]) + program) == "[]"


@pytest.mark.parametrize("words", [("--help",), ("serve", "--port", "0")])
def test_a_python_without_docstrings_is_rejected_in_a_line(tmp_path, words) -> None:
    ended = subprocess.run(
        [sys.executable, "-OO", "-m", "app.cli", *words],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[4])},
    )
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr.startswith("tensormap: Python's option -OO")
    assert len(ended.stderr.splitlines()) == 1


def test_a_command_computes_in_one_thread() -> None:
    pools = "print({pool['num_threads'] for pool in threadpool_info()})"
    program = f"from threadpoolctl import threadpool_info; imported('inspect'); {pools}"
    assert _printed(_RUN.format(words=[]) + program) == "{1}"


def test_a_command_collects_the_garbage_of_its_work_and_not_of_its_imports() -> None:
    shown = "print(gc.isenabled(), gc.get_freeze_count() > 10_000)"
    program = (
        f"import atexit, gc; from app.cli import main; atexit.register(lambda: {shown}); main()"
    )
    assert _printed(_RUN.format(words=["inspect", "--help"]) + program) == "True True"


@pytest.mark.parametrize(
    ("words", "before"),
    [
        (["build", "", "-o", "map.h5"], "build"),  # an unset variable of a shell
        (["build", "drive", "-o", ""], "-o"),
        (["serve", "--data="], "--data"),
        (["recycle-bin", "restore", ""], "restore"),
    ],
)
def test_an_empty_argument_is_rejected_and_is_not_the_current_folder(words, before) -> None:
    shown = CliRunner().invoke(cli, words, env={"COLUMNS": "200"})
    assert shown.exit_code == 2
    assert f"what follows {before!r} is empty" in shown.output


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["build", "drive", "-o", "locked/map.h5"], "locked"),
        (["simulate", "locked/city/drive"], "locked"),
    ],
)
def test_a_folder_that_cannot_be_written_is_named_before_any_work(
    tmp_path, monkeypatch, words, named
) -> None:
    (tmp_path / "locked").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "access", lambda path, _mode: Path(path).name != "locked")
    shown = CliRunner().invoke(cli, words, env={"COLUMNS": "200"})
    assert shown.exit_code == 2
    assert f"{named} cannot be written" in shown.output
    assert not list((tmp_path / "locked").iterdir())


@pytest.mark.parametrize(("name", "shown"), [("inspect", "tensormap: stopped\n"), ("serve", "")])
def test_ctrl_c_ends_a_command_with_a_line_and_a_service_with_its_log(
    monkeypatch, name, shown
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    stopping = typer.Typer()
    stopping.command(name)(interrupted)
    command = typer.main.get_command(stopping)
    monkeypatch.setattr(sys.modules["app.cli.main"], "imported", lambda _name: command)
    ended = CliRunner().invoke(cli, [name])
    assert (ended.exit_code, ended.stderr) == (130, shown)


@pytest.mark.parametrize("step", ["prepare_streams", "stop_after_cleanup"])
def test_ctrl_c_before_a_command_begins_is_no_traceback(monkeypatch, step) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sys.modules["app.cli.main"], step, interrupted)
    assert called("inspect", status=130) == ""


def _simulating(folder: Path, scans: int = 2000) -> "subprocess.Popen[bytes]":
    """Start a command that takes long; return it when it has written its first files."""
    words = [*HEEDING_STOPS, *PROGRAM, "simulate", str(folder / "monday"), "--scans", str(scans)]
    command = subprocess.Popen(words, stderr=subprocess.PIPE)
    while not list(folder.glob(".monday.*/velodyne/*.bin")) and command.poll() is None:
        time.sleep(0.02)
    return command


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP], ids=lambda number: number.name)
def test_a_command_that_is_terminated_or_loses_its_terminal_leaves_no_hidden_folder(
    tmp_path, number
) -> None:
    with _simulating(tmp_path) as command:
        command.send_signal(number)
        _, shown = command.communicate(timeout=30)
    assert (command.returncode, shown.splitlines()[-1]) == (128 + number, b"tensormap: stopped")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_a_stop_that_is_repeated_does_not_end_the_cleanup_of_the_first(tmp_path, number) -> None:
    with _simulating(tmp_path) as command:
        while command.poll() is None:
            command.send_signal(number)
            time.sleep(0.0005)
        _, shown = command.communicate(timeout=30)
    assert shown.splitlines()[-1] == b"tensormap: stopped"
    assert list(tmp_path.iterdir()) == []


def test_a_command_goes_on_after_a_hangup_that_its_caller_ignores(tmp_path) -> None:
    line = "trap '' HUP; tensormap simulate monday --scans 2 & sleep 0.5; kill -HUP $!; wait $!"
    ended = _in_a_shell(line, folder=tmp_path)
    assert (ended.returncode, "stopped" in ended.stderr) == (0, False)


def _in_a_shell(line: str, *, folder: Path) -> "subprocess.CompletedProcess[str]":
    program = f"{sys.executable} -m app.cli"
    return subprocess.run(
        ["/bin/bash", "-c", line.replace("tensormap", program)],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[4])},
    )


def test_a_command_imports_nothing_from_the_current_folder_in_its_other_processes_either(
    tmp_path,
) -> None:
    (tmp_path / "socket.py").write_text("raise SystemExit('of another project')")
    with Store(tmp_path / "data") as store:
        store.maps.create("campus")
        store.drives.put_scan("campus", "monday", 0, Scan.from_returns([[10.0, 0.0, 0.0]]))
    installed = tmp_path / "bin/tensormap"
    installed.parent.mkdir()
    installed.write_text("from app.cli import main\nif __name__ == '__main__': main()")
    ended = subprocess.run(
        [sys.executable, installed, "verify", "--data", "data"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[4])},
    )
    assert ended.stdout == "data: 1 file checked, 0 damaged or missing\n", ended.stderr


@pytest.mark.parametrize(
    "words", [("serve", "--port", "0"), ("verify", "--data", "data"), ("simulate", "drive")]
)
def test_a_current_folder_that_was_removed_is_named(tmp_path, words) -> None:
    program = "import os, sys; os.rmdir(os.getcwd()); os.execv(sys.executable, sys.argv[1:])"
    here = tmp_path / "here"
    here.mkdir()
    ended = subprocess.run(
        [sys.executable, "-c", program, *PROGRAM, *words],
        capture_output=True,
        text=True,
        check=False,
        cwd=here,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[4])},
    )
    assert ended.returncode == 1
    assert ended.stderr.endswith("tensormap: the current folder: No such file or directory\n")
    assert "Traceback" not in ended.stderr


def test_a_folder_that_another_command_filled_meanwhile_is_named_as_it_was_given(tmp_path) -> None:
    with _simulating(tmp_path, scans=40) as command:
        (tmp_path / "monday" / "of another").mkdir(parents=True)
        _, shown = command.communicate(timeout=30)
    named = f"tensormap: {tmp_path / 'monday'}: Directory not empty"
    assert (command.returncode, shown.decode().splitlines()[-1]) == (1, named)
    assert [path.name for path in tmp_path.iterdir()] == ["monday"]


@pytest.mark.parametrize(
    ("encoding", "folder", "shown"),
    [
        ("ascii", "'Grüße'", "Gr\\xfc\\xdfe"),
        ("latin-1", "'€ 5'", "\\u20ac 5"),
        ("utf-8:strict", "$'b\\xff'", "b\\udcff"),
    ],
)
def test_a_name_that_the_output_cannot_encode_is_shown_with_escapes(
    tmp_path, encoding, folder, shown
) -> None:
    line = f"PYTHONIOENCODING={encoding} tensormap simulate {folder} --scans 1 | cat -v"
    ended = _in_a_shell(f"{line}; exit ${{PIPESTATUS[0]}}", folder=tmp_path)
    assert (ended.returncode, "Traceback" in ended.stderr) == (0, False)
    assert f"{shown}: 1 scan of simulated-0" in ended.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("built")
    run("simulate", folder / "monday", "--scans", 3)
    run("build", folder / "monday", "-o", folder / "map.h5")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        "--help",
        "inspect map.h5",
        "localize map.h5 monday --json",
        "signature map.h5 monday/velodyne/000000.bin",
    ],
)
def test_an_output_that_is_full_is_an_error_of_one_line(built, words) -> None:
    ended = _in_a_shell(f"tensormap {words} > /dev/full", folder=built)
    assert ended.returncode == 1
    last = ended.stderr.splitlines()[-1]
    assert last == "tensormap: standard output: No space left on device"
    assert "Traceback" not in ended.stderr


@pytest.mark.slow
@pytest.mark.parametrize("words", ["--help", "inspect map.h5", "localize map.h5 monday --json"])
def test_an_output_that_is_open_for_reading_only_is_an_error_of_one_line(built, words) -> None:
    ended = _in_a_shell(f"tensormap {words} 1< /dev/null", folder=built)
    assert ended.returncode == 1
    assert ended.stderr.splitlines()[-1] == "tensormap: standard output: Bad file descriptor"
    assert "Traceback" not in ended.stderr


@pytest.mark.slow
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_a_command_runs_also_if_its_outputs_are_closed(built, tmp_path, closed) -> None:
    map_file = tmp_path / "again.h5"
    ended = _in_a_shell(f"tensormap build monday -o {map_file} {closed}", folder=built)
    assert (ended.returncode, "Traceback" in ended.stderr) == (0, False)
    assert read_map(map_file).revision == read_map(built / "map.h5").revision


@pytest.mark.slow
@pytest.mark.parametrize("words", ["build monday -o", "simulate --scans 2"])
@pytest.mark.parametrize(
    ("bars", "lost"),
    [("", "2> /dev/full"), ("", "2> >(true)"), ("FORCE_COLOR=1", "2> /dev/full")],
)
def test_progress_and_notes_that_cannot_be_written_do_not_end_the_work(
    built, tmp_path, words, bars, lost
) -> None:
    # `sleep`: the reader of the pipe is gone before the first line.
    line = f"{{ sleep 0.2; {bars} tensormap {words} {tmp_path / 'new'}; }} {lost}"
    ended = _in_a_shell(line, folder=built)
    assert (ended.returncode, "new: " in ended.stdout) == (0, True)
    assert (tmp_path / "new").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "status"), [("inspect nowhere.h5", 1), ("inspect --nonsense", 2), ("inspect", 2)]
)
def test_an_error_that_cannot_be_written_has_its_own_status(tmp_path, words, status) -> None:
    assert _in_a_shell(f"tensormap {words} 2> /dev/full", folder=tmp_path).returncode == status


@pytest.mark.slow
@pytest.mark.parametrize("words", ["inspect map.h5", "localize map.h5 monday --json", "--help"])
def test_a_reader_that_has_read_enough_is_no_error_that_is_shown(built, words) -> None:
    ended = _in_a_shell(f"tensormap {words} | true; exit ${{PIPESTATUS[0]}}", folder=built)
    assert ended.returncode in {0, 1}
    assert not [line for line in ended.stderr.splitlines() if "localizing" not in line]
