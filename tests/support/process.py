"""The service as a process of its own, ended by its process id."""

import os
import signal
import ssl
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import active_children
from pathlib import Path

import httpx2

from tests.support.commands import HEEDING_STOPS, PROGRAM, ROOT

NO_TLS = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
"""To verify nothing by, where a client would read the certificates that the system trusts."""

_ANNOUNCED = "TensorMap at "


@dataclass(frozen=True)
class Server:
    """A service that runs.

    Attributes:
        process: Of the service itself.
        port: Where it listens.
        client: A client of it.
        log: What it writes.
    """

    process: subprocess.Popen[bytes]
    port: int
    client: httpx2.Client
    log: Path

    @property
    def pid(self) -> int:
        return self.process.pid

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
        self.process.send_signal(how)
        self.process.wait(30)


@contextmanager
def serving(
    data_dir: Path,
    log: Path,
    *options: str,
    port: str = "0",
    within: Sequence[str] = (),
    **settings: str,
) -> Iterator[Server]:
    """Run `tensormap serve` until the block ends.

    Args:
        data_dir: Its data.
        log: Where both of its outputs go.
        options: More options of the command.
        port: Its port; by default a free one.
        within: A command that runs the one that follows it, in the same process.
        settings: `TENSORMAP_` variables, without that.
    """
    environment = {
        **{k: v for k, v in os.environ.items() if not k.startswith("TENSORMAP_")},
        **{f"TENSORMAP_{name.upper()}": value for name, value in settings.items()},
    }
    with log.open("ab") as written:
        start = written.tell()
        served = [*PROGRAM, "serve", "--port", port, "--data", str(data_dir), *options]
        process = subprocess.Popen(
            [*HEEDING_STOPS, *within, *served],
            cwd=ROOT,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=written,
            stderr=subprocess.STDOUT,
        )

    def output() -> str:
        return log.read_bytes()[start:].decode(errors="replace")

    try:
        until(lambda: _ANNOUNCED in output() or process.poll() is not None, "the service is silent")
        assert process.poll() is None, output()
        url = output().split(_ANNOUNCED)[1].split()[0].rstrip('"}')  # of JSON
        with httpx2.Client(base_url=url, timeout=60, verify=NO_TLS) as client:
            until(lambda: is_ready(client) or process.poll() is not None, "it is never ready")
            assert process.poll() is None, output()
            yield Server(process, int(url.rpartition(":")[2]), client, log)
    finally:
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(30)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait(30)
                raise


def is_ready(client: httpx2.Client) -> bool:
    """Return whether a service answers that it is ready."""
    try:
        return client.get("/readyz").status_code == 200
    except httpx2.TransportError:
        return False


def until(condition: Callable[[], bool], what: str) -> None:
    """Wait for a condition; five minutes are far more than it takes, on a busy machine too."""
    deadline = time.monotonic() + 300
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


def job_processes() -> list[int]:
    """Return the ids of the processes of jobs that this process has started."""
    return [child.pid for child in active_children() if child.name.startswith("job-") and child.pid]


def is_running(pid: int) -> bool:
    """Return whether a process runs; one that only waits to be reaped does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in {"Z", "X"}
