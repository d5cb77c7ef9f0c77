"""The Python that an environment is made of: one for which all libraries are there."""

import os
import subprocess
import sys

import pytest

from tests.support.commands import ROOT


@pytest.mark.parametrize(
    ("version", "shown"),
    [
        ("3.10.13", "needs Python 3.11 to 3.14"),
        ("3.15.2", "not there for Python 3.15 and newer yet"),
        ("4.0.0", "not there for Python 3.15 and newer yet"),
    ],
)
def test_an_environment_of_another_python_is_refused_with_those_that_are_meant(
    tmp_path, version, shown
) -> None:
    python = tmp_path / "python"
    info = tuple(map(int, version.split(".")))
    python.write_text(
        f"""#!/bin/sh
[ "$1" = -V ] && echo Python {version} && exit
exec {sys.executable} -c "import sys; sys.version_info = {info}
$2"
"""
    )
    python.chmod(0o755)
    done = subprocess.run(
        [ROOT / "tools/make-venv", tmp_path / "venv"],
        env=os.environ | {"PYTHON": str(python)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert shown in done.stderr
    assert f"{python} is Python {version}" in done.stderr
    assert "make PYTHON=python3.1" in done.stderr
    assert not (tmp_path / "venv").exists()
