import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import cast

import pytest
import typer
from typer.testing import CliRunner

from app.cli.main import _MODULES, cli, imported


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
        (["build"], "[last; harmonic: highest]"),
        (["localize"], "[the map's threshold]"),
        (["audit", "verify"], "[data]"),
    ],
)
def test_the_help_of_an_option_shows_its_default_in_brackets(words, default) -> None:
    shown = CliRunner().invoke(cli, [*words, "--help"], env={"COLUMNS": "200"}).output
    assert default in " ".join(shown.split())


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


def test_a_command_on_files_imports_nothing_of_the_service() -> None:
    # A second of the start of a command that takes half of one.
    heavy = "{'fastapi', 'sqlalchemy', 'scipy'}"
    program = f"imported('localize'); print(sorted({heavy} & set(sys.modules)))"
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


def test_a_command_computes_in_one_thread() -> None:
    pools = "print({pool['num_threads'] for pool in threadpool_info()})"
    program = f"from threadpoolctl import threadpool_info; imported('inspect'); {pools}"
    assert _printed(_RUN.format(words=[]) + program) == "{1}"


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
