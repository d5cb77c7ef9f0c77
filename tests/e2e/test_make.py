"""What the Makefile says of itself, and the tools that it calls."""

import re
import subprocess

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
