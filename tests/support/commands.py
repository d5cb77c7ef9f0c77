"""Our programs, each a process of its own, forked from one that has imported all that they need.

A program spends a second of processor time on imports and often little on its work, and the tests
start hundreds. `python -m tests.support.commands SOCKET PID` waits at a socket for what
`command_client.py` sends, and ends with the process of that id.
"""

import atexit
import gc
import importlib
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

from app.process import one_blas_thread
from tests.support.forking import fork_builds
from tests.support.locks import one_at_a_time

__all__ = ["BUILDS_ANEW", "Commands", "commands"]

BUILDS_ANEW = "TESTS_BUILDS_ANEW"
"""The variable that is 1 for a service that is to start what it forks builds from by itself."""

ROOT = Path(__file__).parents[2]
_CLIENT = Path(__file__).with_name("command_client.py")
_REQUEST_BYTES = 200_000
_START_S, _RUN_S = 60.0, 120.0
_LATE = (  # what our programs import no earlier than they need it
    *("app.demo.run", "app.demo.server", "app.main", "app.builds.pipelines", "app.report.page"),
    *("alembic.command", "alembic.config", "anyio._backends._asyncio", "laspy"),
    *("rich._emoji_codes", "sqlalchemy.dialects.sqlite", "uvicorn", "uvicorn.loops.auto"),
    *("uvicorn.lifespan.on", "uvicorn.protocols.http.auto", "uvicorn.protocols.websockets.auto"),
)


@dataclass(frozen=True)
class Commands:
    """What runs `tensormap`, and other modules of ours.

    Attributes:
        client: Words that a module's name and its arguments follow, wherever a program is started.
    """

    client: tuple[str, ...]

    @property
    def program(self) -> tuple[str, ...]:
        """Words that stand in for `tensormap`."""
        return (*self.client, "app.cli")

    def __call__(self, *words: str | Path, status: int = 0, **variables: str) -> str:
        """Run a command, check how it ends, and return what it wrote on both outputs."""
        ended = subprocess.run(
            [*self.program, *map(str, words)],
            cwd=ROOT,
            env={**os.environ, **variables},
            capture_output=True,
            text=True,
            timeout=_RUN_S,
        )
        assert ended.returncode == status, ended.stdout + ended.stderr
        assert "Traceback" not in ended.stderr
        return ended.stdout + ended.stderr


def commands(folder: Path, tests: int) -> Commands:
    """Return what runs commands; the first to ask starts it, for all whose folder is the same.

    Args:
        folder: Where its socket is.
        tests: The process that all tests end with.
    """
    address = folder / "commands"
    with one_at_a_time(folder / "commands.lock"):
        if not address.exists():
            started = subprocess.run(
                [sys.executable, "-m", "tests.support.commands", str(address), str(tests)],
                cwd=ROOT,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                timeout=_START_S,
            )
            assert started.returncode == 0, "the commands cannot be imported"
    return Commands((sys.executable, "-I", "-S", str(_CLIENT), str(address)))


def _serve(address: Path, tests: int) -> None:
    """Fork for every request until `tests` ends; returns in a process that is to be a command."""
    ended = os.pidfd_open(tests)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(str(address))
        listening.listen(64)
        if os.fork() != 0:
            os._exit(0)  # whoever started this need not wait longer
        os.setsid()
        # The worker that started this may keep to one core: this is for all that the tests have.
        os.sched_setaffinity(0, os.sched_getaffinity(tests))
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for those that fork here
        while ended not in select.select([listening.fileno(), ended], [], [])[0]:
            asked, _ = listening.accept()
            with asked:
                if os.fork() == 0:
                    listening.close()
                    os.close(ended)
                    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                    _become(asked)
                    return
    os._exit(0)


def _become(asked: socket.socket) -> None:
    """Fork once more: the child takes the place of the command, this one tells how it ends."""
    message, files, _, _ = socket.recv_fds(asked, _REQUEST_BYTES, 4)
    request = json.loads(message)
    command = os.fork()
    if command == 0:
        asked.close()
        *streams, folder = files
        os.fchdir(folder)
        for number, file in enumerate(streams):
            os.dup2(file, number)
        for file in files:
            os.close(file)
        os.environ.clear()
        os.environ.update(request["environment"])
        sys.argv = request["words"]
        return
    for file in files:
        os.close(file)
    asked.send(str(command).encode())
    ended = os.pidfd_open(command)
    if asked.fileno() in select.select([asked.fileno(), ended], [], [])[0]:  # the client was killed
        os.kill(command, signal.SIGKILL)
    _, status = os.waitpid(command, 0)
    try:
        asked.send(str(os.waitstatus_to_exitcode(status)).encode())
    finally:
        os._exit(0)


def _run() -> None:
    """Run the module that `sys.argv` begins with, and end as an interpreter does, but for one step.

    It would take apart all that was imported, and for that copy every page which it shares with
    other programs: longer than what many of them do.
    """
    status: object = None
    try:
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
    except SystemExit as end:
        status = end.code
    if not isinstance(status, int | None):
        sys.exit(str(status))
    # Both private, and what an interpreter calls: joining threads alone would wait for those of
    # executors, which only the first one ends. Nothing public does it and leaves the rest out.
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status or 0)


def _import_all() -> None:
    """Import what our programs need, each of which imports only its own part by itself."""
    commands_of = importlib.import_module("app.cli.main")._MODULES
    late = importlib.import_module("app.builds.worker").IMPORTED_LATE
    for module in (*_LATE, *late, *(f"app.cli.{name}" for name in commands_of.values())):
        importlib.import_module(module)
    settings = importlib.import_module("app.settings").Settings()
    importlib.import_module("app.main").create_app(settings)  # its routes are worked out once
    one_blas_thread()  # to find the libraries takes longest, and is remembered
    gc.freeze()  # or every program would take most of a second to take all this apart


if __name__ == "__main__":
    _import_all()
    _serve(Path(sys.argv[1]), int(sys.argv[2]))
    serves = sys.argv[:2] == ["app.cli", "serve"] or sys.argv[0] == "tests.support.serve"
    if serves and os.environ.get(BUILDS_ANEW) != "1":
        fork_builds()
    _run()
