"""The service as an administrator runs it: logs, backups while it works, and its end."""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import httpx2
import pytest

from tests.support.process import NO_TLS, ROOT, is_running, until
from tests.support.recording import KITTI, kitti, recording, upload_scan
from tests.support.service import problem_of, upload, wait_for

PROGRAM = (sys.executable, "-m", "app.cli")


def test_a_backup_made_while_the_service_works_is_a_service_once_restored(
    tmp_path, tensormap, serving
):
    data, file, new = tmp_path / "data", tmp_path / "backup.tar", tmp_path / "new"
    scans = recording().scans
    with serving(data, tmp_path / "log") as server:
        server.client.post("/v1/maps", json={"map": "campus"})
        upload(server.client, "monday", recording(scans=6))
        job = server.client.post("/v1/maps/campus/builds", json={"segments": 1}).json()["job"]
        assert wait_for(server.client, job)["state"] == "done"
        stop = threading.Event()

        def put() -> None:
            with httpx2.Client(base_url=server.client.base_url, timeout=60) as client:
                for index in range(1_000):
                    if stop.is_set():
                        return
                    upload_scan(client, "campus", "tuesday", index, scans[index % 48])

        putting = threading.Thread(target=put)
        putting.start()
        try:
            said = tensormap("backup", "--data", data, "-o", file)
        finally:
            stop.set()
            putting.join()
        assert "files" in said
    assert "files" in tensormap("restore", file, "--data", new)
    with serving(new, tmp_path / "log") as server:
        body = kitti(scans[4])
        answer = server.client.post(
            "/v1/maps/campus/localizations/scan", content=body, headers=KITTI
        ).json()
        assert answer["best"]["scan_index"] == 4
        assert server.client.get("/v1/maps/campus/drives/monday").json()["scans"] == 6
        assert not (new / "orphans").exists()


@pytest.fixture
def temporary():
    """A folder whose name is short: a socket's has at most 108 bytes."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def test_the_service_ends_with_what_it_was_asked_answered_and_its_build_queued(
    tmp_path, temporary, serving
):
    """`tensormap serve` itself, with JSON for a log."""
    data, log = tmp_path / "data", tmp_path / "log"
    port, process = started(data, log, TMPDIR=str(temporary))
    url = f"http://127.0.0.1:{port}"
    answered: list[httpx2.Response] = []

    def slow_body():
        body = kitti(recording().scans[40])
        half = len(body) // 2
        yield body[:half]
        process.send_signal(signal.SIGTERM)
        time.sleep(1.0)  # the service is told to end while it reads this
        yield body[half:]

    try:
        with httpx2.Client(base_url=url, timeout=60) as client:
            client.post("/v1/maps", json={"map": "campus"})
            upload(client, "monday", recording(scans=40))
            wanted = {"encoding": "harmonic", "segments": 2}
            job = client.post("/v1/maps/campus/builds", json=wanted).json()["job"]
            wait_for(client, job, {"running", "done"})
            children = children_of(process.pid)
            put = client.put(
                "/v1/maps/campus/drives/monday/scans/40",
                content=slow_body(),
                headers={**KITTI, "X-Request-Id": "last"},
            )
            answered.append(put)
        process.wait(60)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait(30)
    assert answered[0].status_code == 201
    assert process.returncode == 0
    assert not list(temporary.iterdir())
    until(lambda: not any(map(is_running, children)), f"{children} are left over")
    lines = [json.loads(line) for line in log.read_text().splitlines() if line.startswith("{")]
    assert [line["status"] for line in lines if line.get("request_id") == "last"] == [201]
    assert "Traceback" not in log.read_text()
    with serving(data, tmp_path / "second") as server:
        assert server.client.get("/v1/maps/campus/drives/monday").json()["scans"] == 41
        assert wait_for(server.client, job)["state"] == "done"


def test_a_service_manager_hears_of_it_and_its_files_are_private(tmp_path, temporary, tensormap):
    """`tensormap serve` itself, started with the umask that shells have."""
    data, address = tmp_path / "data", temporary / "notify"
    before = os.umask(0o022)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(address))
        manager.settimeout(60)
        manage = {"NOTIFY_SOCKET": str(address), "WATCHDOG_USEC": "2000000"}
        try:
            port, process = started(data, tmp_path / "log", **manage)
        finally:
            os.umask(before)
        try:
            assert [manager.recv(100) for _ in range(3)] == [b"READY=1", *[b"WATCHDOG=1"] * 2]
            with httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=60) as client:
                client.post("/v1/maps", json={"map": "campus"})
                upload(client, "monday", recording(scans=6))
                job = client.post("/v1/maps/campus/builds", json={"segments": 1}).json()["job"]
                assert wait_for(client, job)["state"] == "done"
            files = [data, *data.rglob("*")]
            assert {path.name for path in files} > {"images", "revisions", "catalog.sqlite3-wal"}
            assert [path for path in files if path.stat().st_mode & 0o077] == []
        finally:
            process.terminate()
            while manager.recv(100) != b"STOPPING=1":  # behind those that were sent meanwhile
                pass
            process.wait(30)


def test_nothing_new_is_taken_once_the_service_is_to_end(tmp_path, tensormap):
    port, process = started(tmp_path / "data", tmp_path / "log", tensormap.program)
    try:
        assert httpx2.get(f"http://127.0.0.1:{port}/livez").status_code == 200
        refused = httpx2.get(f"http://127.0.0.1:{port}/v1/maps", headers={"Host": "maps.example"})
        assert problem_of(refused) == (421, "host-not-allowed")
        process.terminate()
        process.wait(30)
        with pytest.raises(httpx2.TransportError):
            httpx2.get(f"http://127.0.0.1:{port}/livez")
    finally:
        if process.poll() is None:
            process.kill()
            process.wait(30)


def started(
    data: Path, log: Path, program: Sequence[str] = PROGRAM, **variables: str
) -> tuple[int, subprocess.Popen[bytes]]:
    """Start `tensormap serve` on a free port."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("TENSORMAP_")}
    with log.open("wb") as sink:
        process = subprocess.Popen(
            [*program, "serve", "--port", "0", "--data", str(data)],
            cwd=ROOT,
            env={**environment, "TENSORMAP_LOG_FORMAT": "json", **variables},
            stdout=sink,
            stderr=subprocess.STDOUT,
        )
    until(lambda: "TensorMap at" in log.read_text() or process.poll() is not None, "no start")
    said = log.read_text()
    assert process.poll() is None, said
    port = int(said.split("TensorMap at ")[1].split()[0].rpartition(":")[2])
    until(lambda: is_ready(port), "not ready")
    return port, process


def is_ready(port: int) -> bool:
    try:
        return httpx2.get(f"http://127.0.0.1:{port}/readyz", verify=NO_TLS).status_code == 200
    except httpx2.TransportError:
        return False


def children_of(pid: int) -> set[int]:
    return {
        int(child)
        for task in Path(f"/proc/{pid}/task").iterdir()
        for child in (task / "children").read_text().split()
    }
