"""`tensormap upload`, killed and repeated."""

import signal
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.support.commands import PROGRAM, ROOT, tensormap
from tests.support.process import serving, until

SCANS, RETURNS = 200, 1000


class Counted:
    """A port that leads to a service and counts the bytes that are sent to it."""

    def __init__(self, port: int) -> None:
        self._to, self._lock = port, threading.Lock()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self.sent_bytes = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):  # closed
            while True:
                client, _ = self._listener.accept()
                service = socket.create_connection(("127.0.0.1", self._to))
                for ends in ((client, service, True), (service, client, False)):
                    threading.Thread(target=self._copy, args=ends, daemon=True).start()

    def _copy(self, source: socket.socket, to: socket.socket, counted: bool) -> None:
        with suppress(OSError):
            while piece := source.recv(2**16):
                if counted:
                    with self._lock:
                        self.sent_bytes += len(piece)
                to.sendall(piece)
        for end in (source, to):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()

    def reached(self, size_bytes: int) -> bool:
        return self.sent_bytes >= size_bytes

    def close(self) -> None:
        self._listener.close()


@contextmanager
def counting(port: int) -> Iterator[Counted]:
    counted = Counted(port)
    try:
        yield counted
    finally:
        counted.close()


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    folder = tmp_path / "recorded"
    (folder / "velodyne").mkdir(parents=True)
    noise = np.random.default_rng(0)
    for index in range(SCANS):
        returns = noise.normal(scale=20, size=(RETURNS, 4)).astype("<f4")
        (folder / "velodyne" / f"{index:06}.bin").write_bytes(returns.tobytes())
    rows = [f"1 0 0 {index} 0 1 0 0 0 0 1 0\n" for index in range(SCANS)]
    (folder / "poses.txt").write_text("".join(rows))
    (folder / "times.txt").write_text("".join(f"{index / 10}\n" for index in range(SCANS)))
    return folder


def test_killed_three_times_it_sends_at_most_a_twentieth_more(drive: Path, tmp_path: Path) -> None:
    with serving(tmp_path / "data", tmp_path / "log") as server:
        with counting(server.port) as whole:
            words = ["--map", "campus", "--drive", "whole", "--create"]
            shown = tensormap("upload", drive, whole.url, *words)
            assert "200 of 200 scans stored" in shown
            assert "200 of 200 have a pose" in shown
        words[3] = "killed"
        with counting(server.port) as counted:
            for part in (1, 2, 3):
                client = subprocess.Popen(
                    [*PROGRAM, "upload", str(drive), counted.url, *words],
                    cwd=ROOT,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
                reached = partial(counted.reached, part * whole.sent_bytes // 4)
                until(reached, "it sends nothing")
                client.send_signal(signal.SIGKILL)
                assert client.wait(30) == -signal.SIGKILL
            shown = tensormap("upload", drive, counted.url, *words)
        assert "200 of 200 have a pose" in shown
        assert counted.sent_bytes <= 1.05 * whole.sent_bytes
        drives = "/v1/maps/campus/drives"
        killed, undisturbed = (
            server.client.get(f"{drives}/{name}").json() for name in ("killed", "whole")
        )
        assert killed["present"] == undisturbed["present"] == [{"first": 0, "last": SCANS - 1}]
        assert killed["returns"] == undisturbed["returns"]
