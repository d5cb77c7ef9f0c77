"""The fenced blocks of a document, and how each kind is run.

`sh` is run by bash and `python` in one namespace a document, in order, in an empty folder where
`.venv/bin/tensormap` is this repository's command; one that begins with `tensormap serve` is the
service, which runs until the document ends. The free port replaces the documents' 8000. A
block `text output` is what the block before writes; other languages are only read.
"""

import contextlib
import doctest
import io
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import httpx2

from tests.support.commands import PROGRAM, ROOT
from tests.support.process import NO_TLS

READ_ONLY = {"text", "json", "yaml", "ini", "nginx"}
_FENCE = re.compile(r"^```(\S*) ?(.*)$")
_PORT = "8000"
_START_S, _RUN_S = 300.0, 600.0  # far more than they take, on a busy machine too
_LENIENT = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


@dataclass(frozen=True)
class Block:
    """One fenced block."""

    language: str
    info: str
    text: str
    where: str

    @property
    def serves(self) -> bool:
        first = self.text.split("\n")[0]
        return (
            self.language == "sh"
            and re.match(r"(\.venv/bin/)?tensormap serve\b", first) is not None
        )


def blocks_of(path: Path) -> list[Block]:
    """Return a document's blocks in order."""
    found: list[Block] = []
    opened: tuple[str, str, int] | None = None
    lines: list[str] = []
    for number, line in enumerate(path.read_text().splitlines(), 1):
        if opened is None:
            if match := _FENCE.match(line):
                opened, lines = (match[1], match[2], number), []
        elif line == "```":
            language, info, start = opened
            found.append(Block(language, info, "\n".join(lines), f"{path.name}:{start}"))
            opened = None
        else:
            lines.append(line)
    assert opened is None, f"{path}: the block of line {opened} does not end"
    return found


def _free_port() -> str:
    """Let the system choose, so that documents can run side by side."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        return str(listening.getsockname()[1])


class Runner:
    """Runs a document's blocks in `folder`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._port = _free_port()
        self._output = ""
        self._namespace: dict[str, object] = {"__name__": "document"}
        self._server: subprocess.Popen[bytes] | None = None
        command = folder / ".venv/bin/tensormap"
        command.parent.mkdir(parents=True)
        command.write_text(f'#!/bin/sh\nexec {shlex.join(PROGRAM)} "$@"\n')
        command.chmod(0o755)
        kept = {k: v for k, v in os.environ.items() if not k.startswith("TENSORMAP_")}
        python = Path(sys.executable).parent
        self._environment = kept | {
            "PATH": f"{command.parent}:{python}:{os.environ['PATH']}",
            "PYTHONPATH": str(ROOT),
            "COLUMNS": "160",
        }

    def run(self, block: Block) -> None:
        text = block.text.replace(_PORT, self._port)
        if block.serves:
            self._serve(text)
        elif block.language == "sh":
            self._output = self._sh(text, block.where)
        elif block.language == "python":
            self._output = self._python(text, block.where)
        elif (block.language, block.info) == ("text", "output"):
            expected = f"{text}\n"
            assert doctest.OutputChecker().check_output(expected, self._output, _LENIENT), (
                f"{block.where}: expected\n{expected}\ngot\n{self._output}"
            )

    def _sh(self, text: str, where: str) -> str:
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", text],
            cwd=self._folder,
            env=self._environment,
            capture_output=True,
            text=True,
            timeout=_RUN_S,
        )
        assert done.returncode == 0, f"{where}: {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    def _python(self, text: str, where: str) -> str:
        shown = io.StringIO()
        with contextlib.chdir(self._folder), contextlib.redirect_stdout(shown):
            exec(compile(text, where, "exec"), self._namespace)
        return shown.getvalue()

    def _serve(self, text: str) -> None:
        self.close()
        log = self._folder / "server.log"
        with log.open("wb") as sink:
            self._server = subprocess.Popen(
                ["bash", "-c", f"exec {text.strip()} --port {self._port}"],
                cwd=self._folder,
                env=self._environment,
                stdout=sink,
                stderr=subprocess.STDOUT,
            )
        ready = f"http://127.0.0.1:{self._port}/readyz"
        deadline = time.monotonic() + _START_S
        while self._server.poll() is None and time.monotonic() < deadline:
            try:
                if httpx2.get(ready, verify=NO_TLS).is_success:
                    return
            except httpx2.TransportError:
                time.sleep(0.1)
        raise AssertionError(f"the service did not start:\n{log.read_text()}")

    def close(self) -> None:
        if self._server is not None:
            self._server.send_signal(signal.SIGTERM)
            self._server.wait(30)
            self._server = None
