"""`tensormap` as a process of its own, and in this process."""

import gc
import io
import logging
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import patch

import pytest
from typer.testing import CliRunner, Result

from app.cli.main import cli, main

ROOT = Path(__file__).parents[2]
PROGRAM = (sys.executable, "-m", "app.cli")
"""Words that replace `tensormap`, which only an installed service has."""
HEEDING_STOPS = ("env", "--default-signal=INT,HUP")
"""Words before a program that heeds what a run in the background or under `nohup` ignores."""

_LOGGERS = ("", "tensormap", "uvicorn", "uvicorn.access", "uvicorn.error", "asyncio")
_RUN_S = 600.0  # far more than one takes, on a busy machine too


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


def called(*words: str | Path, status: int = 0, **variables: str) -> str:
    """Run a command as `tensormap` does, but in this process, which has imported what it needs."""
    outputs = [io.TextIOWrapper(io.BytesIO(), write_through=True) for _ in range(2)]
    with (
        patch.object(sys, "argv", ["tensormap", *map(str, words)]),
        patch.dict(os.environ, variables),
        redirect_stdout(outputs[0]),
        redirect_stderr(outputs[1]),
        _logging_as_before(),
        pytest.raises(SystemExit) as ended,
    ):
        main()
    gc.enable()  # what `serve` does itself once it starts
    shown, errors = (output.buffer.getvalue().decode() for output in outputs)
    assert (ended.value.code or 0) == status, shown + errors
    return shown + errors


@contextmanager
def _logging_as_before() -> Iterator[None]:
    """Undo what `serve` changes for its whole process, so for the tests that follow too."""
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    before = [(one.level, one.disabled, [*one.handlers], [*one.filters]) for one in loggers]
    try:
        yield
    finally:
        for one, (level, disabled, handlers, filters) in zip(loggers, before, strict=True):
            one.setLevel(level)
            one.disabled = disabled
            one.handlers[:], one.filters[:] = handlers, filters


def run(*words: object) -> str:
    """Run a command in this process, raise what it raises, and return its standard output."""
    return _result(words).stdout


def notes_of(*words: object) -> str:
    """Run a command likewise, and return its standard error: progress and notes."""
    return _result(words).stderr


def _result(words: Sequence[object]) -> Result:
    result = CliRunner().invoke(cli, [str(word) for word in words])
    if result.exception is not None:
        raise result.exception
    return result
