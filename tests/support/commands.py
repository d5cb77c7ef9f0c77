"""`tensormap` as a person runs it: each command a process of its own."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

__all__ = ["PROGRAM", "ROOT", "Command", "tensormap"]

ROOT = Path(__file__).parents[2]
PROGRAM = (sys.executable, "-m", "app.cli")
"""Words that stand in for `tensormap`, which only an installed service has."""

Command = Callable[..., str]

_RUN_S = 120.0


def tensormap(*words: str | Path, status: int = 0, **variables: str) -> str:
    """Run a command, check its exit status, and return what it wrote on both outputs."""
    ended = subprocess.run(
        [*PROGRAM, *map(str, words)],
        cwd=ROOT,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        timeout=_RUN_S,
    )
    assert ended.returncode == status, ended.stdout + ended.stderr
    assert "Traceback" not in ended.stderr
    return ended.stdout + ended.stderr
