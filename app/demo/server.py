"""The service as a process of its own."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx2

from app.demo.errors import DemoFailed

_START_S = 60.0  # a cold disk reads SciPy slowly
_STOP_S = 15.0
_TRIED_PORTS = 100


def free_port(first: int = 8000) -> int:
    """Return the first free port from `first`.

    Raises:
        DemoFailed: If none of it and the 99 above it is free.
    """
    last = min(first + _TRIED_PORTS - 1, 65535)
    for port in range(first, last + 1):
        try:
            with socket.create_server(("127.0.0.1", port)):
                return port
        except OSError:
            continue
    raise DemoFailed(f"no port from {first} to {last} is free")


@contextmanager
def running_server(data_dir: Path, port: int) -> Iterator[str]:
    """Run the service on loopback while the block runs, and yield its URL.

    Raises:
        DemoFailed: If it ends or does not answer; the message has its output.
    """
    url = f"http://127.0.0.1:{port}"
    log = data_dir / "server.log"
    data_dir.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "app.cli", "serve", "--port", str(port)]
    # Settings of a real service do not apply to the demonstration.
    environment = {k: v for k, v in os.environ.items() if not k.startswith("TENSORMAP_")}
    with log.open("wb") as sink:
        process = subprocess.Popen(  # noqa: S603 - our own interpreter and arguments
            [*command, "--data", str(data_dir / "data")],
            stdout=sink,
            stderr=subprocess.STDOUT,
            env=environment,
        )
    try:
        _wait_until_ready(process, url, log)
        yield url
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _wait_until_ready(process: subprocess.Popen[bytes], url: str, log: Path) -> None:
    deadline = time.monotonic() + _START_S
    while process.poll() is None and time.monotonic() < deadline:
        try:
            if httpx2.get(f"{url}/readyz", timeout=5.0).is_success:
                return
        except httpx2.TransportError:
            time.sleep(0.1)
    raise DemoFailed(f"the service did not start:\n{log.read_text()}")
