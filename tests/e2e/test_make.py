"""What the Makefile says of itself, and the tools that it calls."""

import os
import re
import shutil
import subprocess

import pytest

from tests.support.commands import ROOT


def test_make_help_lists_every_target() -> None:
    shown = subprocess.run(
        ["make", "--directory", ROOT, "help"], capture_output=True, text=True, check=True
    ).stdout
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)[0].split())
    assert set(re.findall(r"^  make (\S+)  +\S", shown, re.MULTILINE)) == targets


def test_the_pinned_versions_stay_where_no_list_of_others_comes(tmp_path) -> None:
    tools, pinned = tmp_path / "tools", tmp_path / "constraints.txt"
    tools.mkdir()
    pinned.write_text("numpy==2.0.0\n")
    (tools / "make-constraints").write_bytes((ROOT / "tools/make-constraints").read_bytes())
    (tools / "make-venv").write_text(
        """#!/bin/sh
mkdir -p "$1/bin"
printf '#!/bin/sh\\ncase "$*" in *" list "*) echo a==1; exit 1;; esac\\n' >"$1/bin/python"
chmod u+x "$1/bin/python"
"""
    )
    for tool in tools.iterdir():
        tool.chmod(0o700)
    done = subprocess.run([tools / "make-constraints"], cwd=tmp_path, capture_output=True)
    assert done.returncode != 0
    assert pinned.read_text() == "numpy==2.0.0\n"


@pytest.fixture
def clone(tmp_path):
    """A clone whose environment's Python writes what it is called with, and when it has ended."""
    for path in ("Makefile", "pyproject.toml", "constraints.txt", "clients/python/pyproject.toml"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / path, tmp_path / path)
    stub = '#!/bin/sh\necho "$*; PIP_USER=$PIP_USER" >>log\nsleep 0.3\necho end >>log\n'
    made = f"mkdir -p .venv/bin\ncat >.venv/bin/python <<'END'\n{stub}END\n"
    made += "touch .venv/bin/pip\nchmod u+x .venv/bin/python\necho made >>log\n"
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools/make-venv").write_text(f"#!/bin/sh\n{made}")
    (tmp_path / "tools/make-venv").chmod(0o700)
    return tmp_path


def logged(clone, *words, **variables):
    """Run make in a clone, and return the log without what `pip install` installs."""
    subprocess.run(
        ["make", *words], cwd=clone, env={**os.environ, **variables}, check=True, timeout=60
    )
    log = (clone / "log").read_text()
    return [re.sub("install .*;", "install;", line) for line in log.splitlines()]


INSTALLED = ["-m pip install; PIP_USER=0", "end"]


def test_an_environment_of_which_a_killed_run_made_only_a_half_is_made_again(clone):
    (clone / ".venv/bin").mkdir(parents=True)
    (clone / ".venv/bin/python").touch(0o700)
    assert logged(clone, "install") == ["made", *INSTALLED]
    assert logged(clone, "install") == ["made", *INSTALLED]  # nothing more


def test_what_is_installed_is_in_the_environment_also_where_pip_is_set_to_the_users_folder(clone):
    assert logged(clone, "install", PIP_USER="1") == ["made", *INSTALLED]


def test_two_targets_at_once_do_not_install_at_the_same_time(clone):
    assert logged(clone, "-j2", ".venv/.installed", "install") == ["made", *INSTALLED, *INSTALLED]
