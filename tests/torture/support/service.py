"""The service as an operator starts it, in processes of its own, to be attacked and killed."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2

from tests.support.access import ADMIN_KEY, bearer
from tests.support.process import NO_TLS, is_ready, is_running, until
from tests.torture.support.sizes import TREE

_START_S = 300.0  # far more than both take, on a busy machine too
_STOP_S = 120.0  # it gives requests and builds 10 s
_COMMAND_S = 600.0
PROBLEM = "application/problem+json"


class Tortured:
    """A service on a data directory, which may be ended and started again.

    Args:
        data_dir: Its data.
        log: What it writes.
        environment: More variables: settings with their prefix, and what is preloaded.
        within: A command that runs the one that follows it, in the same process.
    """

    def __init__(
        self,
        data_dir: Path,
        log: Path,
        environment: Mapping[str, str],
        within: Sequence[str] = (),
    ) -> None:
        self.data_dir, self.log = data_dir, log
        self._within = within
        self._more = environment
        self._process: subprocess.Popen[bytes] | None = None
        self.port = 0

    @property
    def pid(self) -> int:
        """Of the process that serves."""
        assert self._process is not None
        return self._process.pid

    @property
    def url(self) -> str:
        """Where it listens."""
        return f"http://127.0.0.1:{self.port}"

    def client(self, key: str | None = ADMIN_KEY, **options: Any) -> httpx2.Client:
        """Return a client with a key."""
        headers = {} if key is None else bearer(key)
        options.setdefault("timeout", 60)
        return httpx2.Client(base_url=self.url, headers=headers, verify=NO_TLS, **options)

    def start(self, port: int = 0, *, ready: bool = True) -> None:
        """Start it, by default on a free port, and wait until it answers.

        Args:
            port: Where it listens.
            ready: Whether to wait; a kill may come before that.
        """
        logged_before = self.log.stat().st_size if self.log.exists() else 0
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                [
                    *(*self._within, sys.executable, "-m", "app.cli", "serve"),
                    *("--port", str(port), "--data", self.data_dir),
                ],
                cwd=TREE,
                env=environment_of(**self._more),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        if ready:
            self._find_port(logged_before)
            with self.client(None) as client:
                until(lambda: is_ready(client), "the service does not answer")

    def _find_port(self, logged_before: int) -> None:
        deadline = time.monotonic() + _START_S
        begins = "TensorMap at "
        while begins not in (
            output := self.log.read_bytes()[logged_before:].decode(errors="replace")
        ):
            assert self.is_alive, output[-3000:]
            assert time.monotonic() < deadline, "no start"
            time.sleep(0.02)
        while "\n" not in (rest := output.split(begins)[1]):
            output = self.log.read_bytes()[logged_before:].decode(errors="replace")
        self.port = int(rest.split()[0].rpartition(":")[2])

    @property
    def is_alive(self) -> bool:
        """Whether the process that serves has not ended."""
        return self._process is not None and self._process.poll() is None

    def processes(self) -> list[int]:
        """Return the ids of all its processes, the one that serves first."""
        found = [self.pid]
        for pid in found:  # it grows
            found.extend(_children(pid))
        return found

    def kill(self) -> None:
        """End it as the kernel does when memory runs out, and wait until all of it has ended."""
        left = self.processes()
        assert self._process is not None
        self._process.kill()
        self._process.wait(30)
        until(lambda: not any(map(is_running, left)), f"of processes {left} some are left")

    def stop(self) -> None:
        """End it as a service manager does; kill it when that takes half a minute."""
        if not self.is_alive:
            return
        assert self._process is not None
        left = self.processes()
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            for pid in left:
                if is_running(pid):
                    os.kill(pid, signal.SIGKILL)
            self._process.wait(30)
            raise AssertionError(f"no stop within {_STOP_S:.0f} s: {self.crash_report()}") from None
        try:
            until(lambda: not any(map(is_running, left)), f"a stop leaves some of {left}")
        finally:
            for pid in filter(is_running, left):
                os.kill(pid, signal.SIGKILL)

    def command(self, *words: str | Path, **variables: str) -> subprocess.CompletedProcess[str]:
        """Run a command of ours on its data, with more variables, and return how it ended."""
        return subprocess.run(
            [sys.executable, "-m", "app.cli", *map(str, words)],
            cwd=TREE,
            env=environment_of(TENSORMAP_DATA_DIR=str(self.data_dir), **variables),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_COMMAND_S,
        )

    def has(self, command: str) -> bool:
        """Return whether the service's release has a command."""
        return self.command(command, "--help").returncode == 0

    def crash_report(self) -> str:
        """Return how a process of it crashed last, or the end of its log."""
        log = self.log.read_bytes()[-100_000:].decode(errors="replace")
        _, crash, stack = log.rpartition("Fatal Python error")
        stack = stack.partition("Extension modules")[0]
        return f"{crash}{stack[:2000]}" if crash else log[-4000:]


@contextmanager
def tortured(
    folder: Path,
    environment: Mapping[str, str] | None = None,
    *,
    within: Sequence[str] = (),
    **settings: str,
) -> Iterator[Tortured]:
    """Run a service until the block ends.

    Args:
        folder: All that it stores goes into `disk`, the data into `disk/data`; its log is `log`.
        environment: More variables.
        within: A command that runs the one that follows it, in the same process.
        settings: Settings without their prefix; without `admin_key` it is `ADMIN_KEY`.
    """
    given = {"admin_key": ADMIN_KEY, **settings}
    variables = {f"TENSORMAP_{name.upper()}": value for name, value in given.items()}
    temporary = folder / "disk" / "tmp"
    temporary.mkdir(parents=True)
    variables["TMPDIR"] = str(temporary)
    variables.update(environment or {})
    service = Tortured(folder / "disk" / "data", folder / "log", variables, within)
    try:
        service.start()
        yield service
    finally:
        service.stop()


def environment_of(**more: str) -> dict[str, str]:
    """Return the environment of a program of the tree that is attacked."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith("TENSORMAP_")}
    return {**kept, "PYTHONPATH": str(TREE), "PYTHONFAULTHANDLER": "1", **more}


def named(response: httpx2.Response) -> str:
    """Return the name of a problem; anything else that is no success is a failure."""
    excerpt = response.text[:300]
    assert response.headers.get("content-type") == PROBLEM, f"{response.status_code}: {excerpt}"
    name: str = response.json()["type"].removeprefix("/problems/")
    return name


def _children(pid: int) -> list[int]:
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        return [int(c) for task in tasks for c in (task / "children").read_text().split()]
    except (FileNotFoundError, ProcessLookupError):
        return []
