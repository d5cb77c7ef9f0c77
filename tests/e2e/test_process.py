"""The service as a process: over a socket, killed, stopped and started again."""

import http.client
import io
import os
import signal
import socket
import threading
from pathlib import Path

import httpx2
import numpy as np
import pytest

from tests.support.commands import ROOT
from tests.support.process import is_running, serving, until
from tests.support.recording import KITTI, kitti, recording, upload_scan
from tests.support.service import problem_of, upload, wait_for


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("server")
    with serving(folder / "data", folder / "log") as server:
        server.client.post("/v1/maps", json={"map": "campus"})
        yield server


def put_until_it_ends(server, acknowledged, enough):
    """Put scan after scan, and note those that were acknowledged."""
    drive = recording()
    try:
        for index in range(10**6):
            put = upload_scan(server.client, "campus", "monday", index, drive.scans[index % 48])
            assert put.status_code == 201
            acknowledged.append(index)
            if index == 30:
                enough.set()
    except httpx2.TransportError:
        enough.set()  # the end


def end_in_the_middle(server, how):
    """End a service that builds, and see that what it started ends with it."""
    until(lambda: bool(server.children()), "no process was started for the build")
    children = server.children()
    server.end(how)
    until(lambda: not any(map(is_running, children)), f"{children} are left over")


def test_no_process_of_the_service_shows_the_administrators_key_in_its_environment(tmp_path):
    """A job's process reads files of others; the system shows it the environment of the service."""
    key = "correct horse battery staple"
    with serving(tmp_path / "data", tmp_path / "log", admin_key=key) as server:
        server.client.headers["Authorization"] = f"Bearer {key}"
        server.client.post("/v1/maps", json={"map": "campus"}).raise_for_status()
        upload(server.client, "monday", recording(scans=6))
        job = server.client.post("/v1/maps/campus/builds", json={"segments": 1}).json()["job"]
        until(lambda: bool(server.children()), "no process was started for the build")
        shown = {
            pid: Path(f"/proc/{pid}/environ").read_bytes()
            for pid in (server.pid, *server.children())
        }
        assert wait_for(server.client, job)["state"] == "done"
    assert all(b"PATH=" in environment for environment in shown.values())
    assert not any(key.encode() in environment for environment in shown.values())


def test_what_was_acknowledged_outlives_a_kill_and_what_was_begun_is_done_after_it(tmp_path):
    data_dir, log = tmp_path / "data", tmp_path / "log"
    acknowledged: list[int] = []
    with serving(data_dir, log) as server:
        server.client.post("/v1/maps", json={"map": "campus"})
        upload(server.client, "tuesday", recording(scans=6))
        body = {"drives": ["tuesday"]}
        enough = threading.Event()
        putting = threading.Thread(target=put_until_it_ends, args=(server, acknowledged, enough))
        putting.start()
        assert enough.wait(60)
        job = server.client.post("/v1/maps/campus/builds", json=body).json()["job"]
        wait_for(server.client, job, {"running", "done"})
        end_in_the_middle(server, signal.SIGKILL)
        putting.join()
    with serving(data_dir, log) as server:
        wait_for(server.client, job, {"running", "done"})
        # A service manager and Ctrl-C signal the whole group, the build's process too.
        for child in server.children():
            os.kill(child, signal.SIGTERM)
            os.kill(child, signal.SIGINT)
        end_in_the_middle(server, signal.SIGTERM)
    with serving(data_dir, log) as server:
        assert len(acknowledged) > 30
        for index in acknowledged:
            got = server.client.get(f"/v1/maps/campus/drives/monday/scans/{index}")
            points = np.load(io.BytesIO(got.content), allow_pickle=False)
            assert points.tobytes() == recording().scans[index % 48].points_m.tobytes()
        done = wait_for(server.client, job)
        assert done["state"] == "done"
        live = server.client.get("/v1/maps/campus").json()["live_revision"]
        assert live == done["revision"]
    assert not list(data_dir.rglob("*.part"))


@pytest.mark.parametrize("declared", [True, False], ids=["declared", "chunked"])
def test_a_body_beyond_the_limit_gets_an_answer_and_is_not_cut_off(server, declared):
    megabyte = bytes(2**20)
    content = (megabyte for _ in range(80))
    headers = {**KITTI, "Content-Length": str(80 * 2**20)} if declared else KITTI
    with httpx2.Client(base_url=f"http://127.0.0.1:{server.port}", timeout=60) as client:
        refused = client.put(
            "/v1/maps/campus/drives/monday/scans/0", content=content, headers=headers
        )
    assert problem_of(refused) == (413, "body-too-large")


def test_a_client_that_disconnects_during_a_request_is_not_an_internal_error(server):
    request = (
        b"PUT /v1/maps/campus/drives/monday/scans/1 HTTP/1.1\r\nHost: 127.0.0.1\r\n"
        b"Content-Type: application/vnd.tensormap.kitti\r\nContent-Length: 1000000\r\n\r\n"
    )
    with socket.create_connection(("127.0.0.1", server.port)) as connection:
        connection.sendall(request + bytes(1_000))
    put = upload_scan(server.client, "campus", "tuesday", 0, recording().scans[0])
    assert put.status_code in {200, 201}
    log = server.log.read_text()
    assert "Traceback" not in log, log
    listed = server.client.get("/v1/maps/campus/drives").json()["items"]
    assert [drive["drive"] for drive in listed] == ["tuesday"]


@pytest.mark.parametrize(
    "target",
    [
        "/v1/maps/../../../etc/passwd",
        "/v1/maps/..%2f..%2f..%2fetc%2fpasswd",
        "/static-offline-docs/../../../../etc/passwd",
        "/static-offline-docs/..%2f..%2f..%2f..%2fetc%2fpasswd",
        "/static-offline-docs/%2fetc%2fpasswd",
        "/static-offline-docs/%00",
        "/v1/maps/%00/drives/%00/scans/0",
        "/problems/../../etc/passwd",
        "//etc/passwd",
        "/v1/maps/" + "%2e%2e%2f" * 3_000,
    ],
)
def test_no_path_leads_out_of_the_api(server, target):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=60)
    connection.request("GET", target)
    response = connection.getresponse()
    body = response.read()
    connection.close()
    assert response.status in {404, 422}, target
    assert response.getheader("Content-Type") == "application/problem+json"
    assert b"root:" not in body


def test_a_page_elsewhere_that_points_its_name_at_this_machine_is_refused(server):
    for host in ("maps.example", f"maps.example:{server.port}", "127.0.0.1.nip.example"):
        refused = server.client.get("/v1/maps", headers={"Host": host})
        assert problem_of(refused) == (421, "host-not-allowed")
    localize = server.client.post(
        "/v1/maps/campus/localizations/scan",
        content=kitti(recording().scans[0]),
        headers={**KITTI, "Host": "maps.example"},
    )
    assert problem_of(localize) == (421, "host-not-allowed")


def test_a_start_names_the_data_directory_which_may_be_relative_to_where_it_was_started(tmp_path):
    relative = os.path.relpath(tmp_path / "data", ROOT)
    with serving(Path(relative), tmp_path / "log") as server:
        server.client.get("/livez")
    assert f"the data directory is {tmp_path / 'data'}\n" in (tmp_path / "log").read_text()


def test_a_second_service_on_the_same_data_does_not_start(server):
    second = serving(server.log.parent / "data", server.log.parent / "second")
    with (
        pytest.raises(AssertionError, match=r"a service or a command uses .*: stop it first"),
        second,
    ):
        pass
    assert server.client.get("/readyz").status_code == 200
