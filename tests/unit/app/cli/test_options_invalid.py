"""Options that make no parameters of a build are named, with what was wanted and what came."""

import pytest
from typer.testing import CliRunner

from app.cli.main import cli


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--encoding", "Paper"], "--encoding should be 'paper' or 'harmonic', got 'Paper'"),
        (["--sensor-height-m", "0"], "--sensor-height-m should be greater than 0, got 0.0"),
        (["--segments", "5", "--segment-length", "4"], "give segment_length or segments, not both"),
        (["--lateral-renderings", ",".join("9" * 99)], "--lateral-renderings should have at most"),
    ],
)
def test_an_option_that_is_wrong_is_named_with_what_came(tmp_path, options, message):
    words = ["build", str(tmp_path), "-o", str(tmp_path / "map.h5"), *options]
    shown = CliRunner().invoke(cli, words, env={"COLUMNS": "200"})
    assert shown.exit_code == 2
    assert message in shown.output
    assert "Input" not in shown.output
    assert "Value error" not in shown.output


@pytest.mark.parametrize(
    "words", [("build", "--lateral-renderings", "x"), ("report", "--ranks", "x")]
)
def test_a_list_that_is_none_is_rejected_by_the_name_of_its_option(tmp_path, words):
    command, *options = words
    line = [command, str(tmp_path), "-o", str(tmp_path / "out"), *options]
    shown = CliRunner().invoke(cli, line, env={"COLUMNS": "200"})
    assert shown.exit_code == 2
    assert f"Invalid value for '{options[0]}': 'x' is no " in shown.output


@pytest.mark.parametrize("lateral_m", ["20", "-12", "nan"])
def test_a_vehicle_that_is_simulated_too_far_beside_the_line_is_rejected_with_the_limit(
    tmp_path, lateral_m
):
    words = ["simulate", str(tmp_path / "drive"), f"--lateral-m={lateral_m}"]
    shown = CliRunner().invoke(cli, words, env={"COLUMNS": "200"})
    assert shown.exit_code == 2
    message = f"Invalid value for '--lateral-m': {lateral_m} m, wanted less than 12 m either way"
    assert message in shown.output
    assert not (tmp_path / "drive").exists()
    usage = CliRunner().invoke(cli, ["simulate", "--help"], env={"COLUMNS": "200"})
    assert "less than 12 m either way" in usage.output
