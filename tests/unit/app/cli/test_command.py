"""How commands read their options, and show them in the help."""

import pytest
from typer.testing import CliRunner

from app.cli.main import _MODULES, cli
from tests.support.commands import called


@pytest.mark.parametrize(
    ("line", "option"),
    [
        ("compare monday --unknown tuesday --unknown wednesday", "--unknown"),
        ("evaluate monday --encoding paper --encoding=harmonic", "--encoding"),
        ("localize map.h5 a.bin -k 2 -k3", "-k"),
        ("build monday -o a.h5 --output b.h5", "--output"),
        ("audit verify --data a --data b", "--data"),
        ("recycle-bin list --data a --data b", "--data"),
        ("recycle-bin restore 1 --name a --name b", "--name"),
        ("recycle-bin purge 1 --data a --data b", "--data"),
    ],
)
def test_an_option_of_one_value_that_is_given_twice_is_rejected(line, option) -> None:
    shown = called(*line.split(), status=2, COLUMNS="200")
    assert option in shown
    assert "it is given more than once, wanted one value" in shown


@pytest.mark.parametrize(
    "line",
    [
        "where a.bin --map a.h5 --map b.h5 --json --json",
        "evaluate nowhere --unknown a --unknown b",
        "verify --data data",
    ],
)
def test_options_that_may_be_repeated_and_flags_are_not(line, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "more than once" not in called(*line.split(), status=1)


@pytest.mark.parametrize(
    "words",
    [[], ["audit", "verify"], ["recycle-bin", "purge"], *([name] for name in _MODULES)],
    ids=" ".join,
)
def test_the_help_shows_no_value_of_a_flag(words) -> None:
    shown = CliRunner().invoke(cli, [*words, "--help"], env={"COLUMNS": "200"}).output
    assert "--help" in shown
    assert "bool" not in shown
