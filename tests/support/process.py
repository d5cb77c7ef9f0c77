"""The service as a process of its own, ended by its process id."""

import os
import signal
import ssl
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx2

from tests.support.commands import BUILDS_ANEW, Commands

__all__ = ["NO_TLS", "Server", "is_running", "serving", "until"]

ROOT = Path(__file__).parents[2]

NO_TLS = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
"""To verify nothing by, where a client would read the certificates that the system trusts."""


@dataclass(frozen=True)
class Server:
    """A service that runs.

    Attributes:
        process: What was started.
        pid: Of the service itself.
        port: Where it listens, on loopback.
        client: A client of it.
        log: What it writes.
    """

    process: subprocess.Popen[str]
    pid: int
    port: int
    client: httpx2.Client
    log: Path

    def children(self) -> set[int]:
        """Return the ids of the processes that it started."""
        listed = Path(f"/proc/{self.pid}/task")
        return {
            int(child)
            for task in listed.iterdir()
            for child in (task / "children").read_text().split()
        }

    def end(self, how: signal.Signals) -> None:
        """Send a signal and wait for its end."""
        os.kill(self.pid, how)
        self.process.wait(30)


@contextmanager
def serving(
    data_dir: Path,
    log: Path,
    *,
    within: Sequence[str] = (),
    commands: Commands | None = None,
    builds_anew: bool = False,
    **settings: str,
) -> Iterator[Server]:
    """Run a service until the block ends.

    Args:
        data_dir: Its data.
        log: Where its standard error goes.
        within: A command that runs the one that follows it, in the same process.
        commands: What forks it; it is started anew without them.
        builds_anew: Whether it starts the process that builds are forked from by itself, late.
        settings: More `TENSORMAP_` variables, without that.
    """
    environment = {
        **{k: v for k, v in os.environ.items() if not k.startswith("TENSORMAP_")},
        "PYTHONPATH": str(ROOT),
        "TENSORMAP_DATA_DIR": str(data_dir),
        **{f"TENSORMAP_{name.upper()}": value for name, value in settings.items()},
        BUILDS_ANEW: str(int(builds_anew)),
    }
    started = (sys.executable, "-m") if commands is None else commands.client
    with log.open("a") as written:
        process = subprocess.Popen(
            [*within, *started, "tests.support.serve"],
            stdout=subprocess.PIPE,
            stderr=written,
            text=True,
            env=environment,
            cwd=ROOT,
        )
    assert process.stdout is not None
    try:
        port, pid = map(int, process.stdout.readline().split())
        url = f"http://127.0.0.1:{port}"
        with httpx2.Client(base_url=url, timeout=60, verify=NO_TLS) as client:
            assert client.get("/readyz").status_code == 200
            yield Server(process, pid, port, client, log)
    finally:
        if process.poll() is None:
            process.terminate()
            process.wait(30)
        process.stdout.close()


def until(condition: Callable[[], bool], what: str) -> None:
    """Wait for a condition; a minute is far more than it takes."""
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


def is_running(pid: int) -> bool:
    """Return whether a process runs; one that only waits to be reaped does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in {"Z", "X"}
