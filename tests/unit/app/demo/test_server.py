import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import httpx2
import pytest

from app.demo import server
from app.demo.client import DemoClient
from app.demo.errors import DemoFailed
from app.demo.server import running_server


class _Ready(BaseHTTPRequestHandler):
    """Answers as a service does that is ready."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_of_it: object) -> None:
        """Show nothing."""


@pytest.fixture
def other_port() -> Iterator[int]:
    """The port of another service."""
    with HTTPServer(("127.0.0.1", 0), _Ready) as other:
        thread = threading.Thread(target=other.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            yield other.server_address[1]
        finally:
            other.shutdown()
            thread.join()


@pytest.mark.slow
def test_the_service_of_another_demonstration_is_not_taken_for_its_own(
    other_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Both look for a port in the same second, and find the same.
    monkeypatch.setattr(server, "_is_free", lambda _port: True)
    with running_server(tmp_path, other_port) as running:
        url = running.url
        assert url != f"http://127.0.0.1:{other_port}"
        assert httpx2.get(f"{url}/v1/maps").json() == {"items": [], "next_after": None}
    assert "TensorMap at" in (tmp_path / "server.log").read_text()


@pytest.mark.slow
def test_the_service_is_reached_without_the_proxies_of_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("no_proxy", "NO_PROXY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("all_proxy", "socks5://127.0.0.1:9")  # its package is not installed
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    with (
        running_server(tmp_path) as running,
        DemoClient(running.url, "campus") as client,
        pytest.raises(DemoFailed, match="there is no map"),
    ):
        client.mapped_scans()


def test_where_no_port_is_free_the_tried_ones_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_TRIED_PORTS", 1)
    with (
        socket.create_server(("127.0.0.1", 0)) as taken,
        pytest.raises(DemoFailed, match="is free") as raised,
        running_server(tmp_path, port := taken.getsockname()[1]),
    ):
        pass
    assert str(raised.value) == f"no port from {port} to {port} is free"


@pytest.mark.slow
def test_a_service_that_does_not_start_says_why(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("no folder")
    with pytest.raises(DemoFailed, match="did not start") as raised, running_server(tmp_path, 8300):
        pass
    assert "data" in str(raised.value)


@pytest.mark.slow
def test_waiting_ends_when_the_service_does(tmp_path: Path) -> None:
    with running_server(tmp_path, 8300) as running:
        threading.Timer(0.5, running._process.kill).start()
        with pytest.raises(DemoFailed, match="the service ended with -9:\nTensorMap at http"):
            running.wait()


@pytest.mark.slow
def test_a_signal_while_a_demonstration_waits_for_its_service_leaves_none_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waited: list[float | None] = []
    wait = subprocess.Popen.wait

    def interrupted(process: "subprocess.Popen[bytes]", timeout: float | None = None) -> int:
        waited.append(timeout)
        if len(waited) == 1:
            os.kill(process.pid, signal.SIGSTOP)  # it does not end in time
            raise KeyboardInterrupt
        return wait(process, timeout)

    monkeypatch.setattr(subprocess.Popen, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt), running_server(tmp_path, 8300) as running:
        pass
    with pytest.raises(httpx2.TransportError):
        httpx2.get(f"{running.url}/livez", timeout=1.0)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="a request to Linux")
def test_a_demonstration_that_is_killed_leaves_no_service_behind(tmp_path: Path) -> None:
    lines = [
        "import sys, time; from pathlib import Path; from app.demo.server import running_server",
        "with running_server(Path(sys.argv[1]), 8300) as running:",
        "    print(running.url, flush=True)",
        "    time.sleep(60)",
    ]
    command = [sys.executable, "-c", "\n".join(lines), str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as demonstration:
        assert demonstration.stdout is not None
        url = demonstration.stdout.readline().strip()
        assert httpx2.get(f"{url}/livez").is_success
        demonstration.kill()
    deadline_s = time.monotonic() + 15.0
    while "Finished server process" not in (tmp_path / "server.log").read_text():
        assert time.monotonic() < deadline_s, "the service runs"
        time.sleep(0.05)
    with pytest.raises(httpx2.TransportError):
        httpx2.get(f"{url}/livez", timeout=1.0)
