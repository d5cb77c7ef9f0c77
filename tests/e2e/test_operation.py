"""Operation: logs, backups of a running service, and its shutdown."""

import json
import os
import signal
import socket
import tempfile
import threading
import time
from pathlib import Path

import httpx2
import pytest
from sqlalchemy import insert

from storage.catalog.models import ExpectedPose
from storage.store import Store
from tests.support.commands import tensormap
from tests.support.process import is_running, serving, until
from tests.support.recording import KITTI, kitti, recording, upload_scan
from tests.support.service import problem_of, upload, wait_for


def test_a_backup_made_while_the_service_works_is_a_service_once_restored(tmp_path):
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
            shown = tensormap("backup", "--data", data, "-o", file)
        finally:
            stop.set()
            putting.join()
        assert "files" in shown
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


def test_the_service_stops_with_requests_answered_and_its_build_queued(tmp_path, temporary):
    data, log = tmp_path / "data", tmp_path / "log"
    answered: list[httpx2.Response] = []
    within = ["env", f"TMPDIR={temporary}"]
    with serving(data, log, within=within, log_format="json") as server:

        def slow_body():
            body = kitti(recording().scans[40])
            half = len(body) // 2
            yield body[:half]
            server.process.send_signal(signal.SIGTERM)
            time.sleep(1.0)  # the service is stopped while it reads this
            yield body[half:]

        server.client.post("/v1/maps", json={"map": "campus"})
        upload(server.client, "monday", recording(scans=40))
        sent = {"encoding": "harmonic", "segments": 2, "views": "full"}
        job = server.client.post("/v1/maps/campus/builds", json=sent).json()["job"]
        wait_for(server.client, job, {"running", "done"})
        children = server.children()
        put = server.client.put(
            "/v1/maps/campus/drives/monday/scans/40",
            content=slow_body(),
            headers={**KITTI, "X-Request-Id": "last"},
        )
        answered.append(put)
        server.process.wait(60)
    assert answered[0].status_code == 201
    assert server.process.returncode == 0
    assert not list(temporary.iterdir())
    until(lambda: not any(map(is_running, children)), f"{children} are left over")
    lines = [json.loads(line) for line in log.read_text().splitlines()]  # each is an object
    assert lines[0]["event"].startswith("TensorMap at http://127.0.0.1:")
    assert [line["status"] for line in lines if line.get("request_id") == "last"] == [201]
    assert "Traceback" not in log.read_text()
    with serving(data, tmp_path / "second") as server:
        assert server.client.get("/v1/maps/campus/drives/monday").json()["scans"] == 41
        assert wait_for(server.client, job)["state"] == "done"


def test_the_service_ends_within_its_limits_although_a_request_hangs(tmp_path):
    data, log = tmp_path / "data", tmp_path / "log"
    answered: list[httpx2.Response] = []
    with serving(data, log, log_format="json") as server:
        server.client.post("/v1/maps", json={"map": "campus"})
        upload(server.client, "monday", recording(scans=1))
        [stored] = (data / "maps").rglob("*.h5")
        stored.unlink()
        os.mkfifo(stored)  # to open it takes until somebody writes to it

        def ask():
            answered.append(server.client.get("/v1/maps/campus/drives/monday/scans/0"))

        asking = threading.Thread(target=ask)
        asking.start()
        time.sleep(1.0)  # it hangs now: if it came too late it would have no answer
        begun_s = time.monotonic()
        server.process.send_signal(signal.SIGTERM)
        server.process.wait(60)
        took_s = time.monotonic() - begun_s
        asking.join()
    assert problem_of(answered[0]) == (503, "service-busy")
    assert took_s < 20.0  # of compose.yaml
    lines = [json.loads(line) for line in log.read_text().splitlines() if line.startswith("{")]
    [hung] = [line["event"] for line in lines if line["logger"] == "tensormap.stop"]
    assert hung.startswith("work on a request did not end within 1 s, in ")


def test_a_stop_ends_the_events_of_a_job_and_does_not_wait_for_it(tmp_path):
    data, log = tmp_path / "data", tmp_path / "log"
    with serving(data, log) as server:
        server.client.post("/v1/maps", json={"map": "campus"})
        upload(server.client, "monday", recording(scans=2))
        [stored] = (data / "maps").rglob("*.h5")
        stored.unlink()
        os.mkfifo(stored)  # the build waits until somebody writes to it
        job = server.client.post("/v1/maps/campus/builds", json={}).json()["job"]
        with server.client.stream("GET", f"/v1/jobs/{job}/events") as events:
            lines = events.iter_lines()
            assert any('"state":"running"' in line for line in lines)
            server.process.send_signal(signal.SIGTERM)
            for _ in lines:  # to their end: they are not cut off
                pass
        server.process.wait(60)
    assert server.process.returncode == 0
    assert "graceful shutdown exceeded" not in log.read_text()


def test_a_stop_does_not_wait_for_the_purge_of_a_request_and_the_next_start_ends_it(tmp_path):
    data, log = tmp_path / "data", tmp_path / "log"
    answered: list[httpx2.Response] = []
    with Store(data) as store:
        store.maps.create("campus")
        store.drives.put_scan("campus", "monday", 0, recording().scans[0])
        drive = store.catalog.drives.get("campus", "monday")
        with store.catalog._database.writing() as session:
            rows = [{"drive_id": drive.id, "index": index} for index in range(1, 100_000)]
            session.execute(insert(ExpectedPose), rows)  # their purge takes seconds
    with serving(data, log) as server:

        def purge():
            with httpx2.Client(base_url=server.client.base_url, timeout=60) as client:
                answered.append(client.delete("/v1/maps/campus?purge=true"))

        purging = threading.Thread(target=purge)
        purging.start()
        until(lambda: server.client.get("/v1/maps/campus").status_code == 404, "no purge has begun")
        server.process.send_signal(signal.SIGTERM)
        server.process.wait(60)
        purging.join()
    assert answered[0].status_code == 204
    assert server.process.returncode == 0
    assert "a stop interrupts the purge of map" in log.read_text()
    with Store(data) as store:
        assert [purge.drive_id for purge in store.catalog.purges.begun()] == [None]
        with serving(data, tmp_path / "second"):
            until(lambda: not store.catalog.purges.begun(), "the purge does not go on")


def test_a_service_manager_is_notified_and_the_files_are_private(tmp_path, temporary):
    data, address = tmp_path / "data", temporary / "notify"
    shells = ["sh", "-c", 'umask 022 && exec "$0" "$@"']
    manager_sets = ["env", f"NOTIFY_SOCKET={address}", "WATCHDOG_USEC=2000000"]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(address))
        manager.settimeout(60)
        with serving(data, tmp_path / "log", within=[*shells, *manager_sets]) as server:
            assert [manager.recv(100) for _ in range(3)] == [b"READY=1", *[b"WATCHDOG=1"] * 2]
            server.client.post("/v1/maps", json={"map": "campus"})
            upload(server.client, "monday", recording(scans=6))
            job = server.client.post("/v1/maps/campus/builds", json={"segments": 1}).json()["job"]
            assert wait_for(server.client, job)["state"] == "done"
            files = [data, *data.rglob("*")]
            assert {path.name for path in files} > {"images", "revisions", "catalog.sqlite3-wal"}
            assert [path for path in files if path.stat().st_mode & 0o077] == []
            server.process.terminate()
            while manager.recv(100) != b"STOPPING=1":  # behind those that were sent meanwhile
                pass


def test_nothing_new_is_taken_once_the_service_is_to_end(tmp_path):
    with serving(tmp_path / "data", tmp_path / "log") as server:
        refused = server.client.get("/v1/maps", headers={"Host": "maps.example"})
        assert problem_of(refused) == (421, "host-not-allowed")
        server.end(signal.SIGTERM)
        with pytest.raises(httpx2.TransportError):
            server.client.get("/livez")


def test_a_service_whose_terminal_ends_stops_as_if_it_was_told_to(tmp_path):
    with serving(tmp_path / "data", tmp_path / "log") as server:
        server.end(signal.SIGHUP)
        assert server.process.returncode == 0
    assert "Application shutdown complete" in (tmp_path / "log").read_text()
