"""The service as a process of its own."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Never

import httpx2

from app.demo.errors import DemoFailed

_START_S = 60.0  # a cold disk reads SciPy slowly
_STOP_S = 15.0
_TRIED_PORTS, _LAST_PORT = 100, 65535
_LISTENING = re.compile(r"^TensorMap at (http://\S+)\n", re.MULTILINE)
_TAKEN = "cannot listen on"
# As text, as this package does not import the command line, which imports it.
_SERVICE = "import app.process; app.process.end_with_parent(); from app.cli import main; main()"


@dataclass(frozen=True, eq=False)
class RunningServer:
    """A service that runs.

    Attributes:
        url: Where it listens.
    """

    url: str
    _process: subprocess.Popen[bytes]
    _log: Path

    def wait(self) -> Never:
        """Wait until it ends, which it does not by itself.

        Raises:
            DemoFailed: When it does, with its output.
        """
        status = self._process.wait()
        raise DemoFailed(f"the service ended with {status}:\n{self._log.read_text()}")


@contextmanager
def running_server(data_dir: Path, first_port: int = 8000) -> Iterator[RunningServer]:
    """Run the service on loopback while the block runs, and yield it.

    Args:
        data_dir: Its log and the folder of its data are made there.
        first_port: It listens on the first free one from this.

    Raises:
        DemoFailed: If it ends or does not answer, with its output; or if none of the 100 ports is
            free.
    """
    log = data_dir / "server.log"
    data_dir.mkdir(parents=True, exist_ok=True)
    last_port = min(first_port + _TRIED_PORTS - 1, _LAST_PORT)
    for port in range(first_port, last_port + 1):
        if not _is_free(port):
            continue
        process = _started(data_dir / "data", port, log)
        try:
            url = _url_of(process, log)
            if url is None:
                continue
            yield RunningServer(url, process, log)
        finally:
            _end(process)
        return
    raise DemoFailed(f"no port from {first_port} to {last_port} is free")


def _is_free(port: int) -> bool:
    try:
        with socket.create_server(("127.0.0.1", port)):
            return True
    except OSError:
        return False


def _started(data_dir: Path, port: int, log: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", _SERVICE, "serve", "--port", str(port)]
    # Settings of a real service do not apply to the demonstration.
    environment = {k: v for k, v in os.environ.items() if not k.startswith("TENSORMAP_")}
    with log.open("wb") as sink:
        return subprocess.Popen(  # noqa: S603 - our own interpreter and arguments
            [*command, "--data", str(data_dir)],
            stdout=sink,
            stderr=subprocess.STDOUT,
            env=environment,
        )


def _url_of(process: subprocess.Popen[bytes], log: Path) -> str | None:
    """Return the URL of a service that is ready, `None` if another one took its port meanwhile.

    That one may answer too, as if it were ours: only one whose log says that it listens is queried.
    """
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline:
        has_ended = process.poll() is not None  # before its log is read, which is whole then
        shown = log.read_text()
        listening = _LISTENING.search(shown)
        if has_ended:
            if _TAKEN in shown:
                return None
            break
        try:
            # Without the environment's proxies, which do not reach this machine.
            if listening and httpx2.get(f"{listening[1]}/readyz", trust_env=False).is_success:
                return listening[1]
        except httpx2.TransportError:
            pass
        time.sleep(0.1)
    raise DemoFailed(f"the service did not start:\n{log.read_text()}")


def _end(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGTERM)
    try:
        process.wait(_STOP_S)
    except subprocess.TimeoutExpired:
        pass
    finally:  # also where a signal interrupts the wait
        process.kill()
        process.wait()
