"""Bodies that are slow, stop, or are sent after a rejection; clients that leave."""

import socket
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress

import pytest

from tests.support.process import serving
from tests.support.recording import TAR, npy, recording, tar, upload_scan
from tests.support.service import problem_of, upload, wait_for

SCENE = recording(scans=6)
DRIVE = "/v1/maps/campus/drives/monday"
SCANS = SCENE.scans
HELD = 60  # more than the framework has threads


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A service that waits for a body for two seconds."""
    folder = tmp_path_factory.mktemp("slow")
    settings = {"body_idle_s": "2", "heavy_threads": "2", "heavy_threads_per_key": "1"}
    with serving(folder / "data", folder / "log", **settings) as server:
        server.client.post("/v1/maps", json={"map": "campus"})
        yield server


def connected(server):
    return socket.create_connection(("127.0.0.1", server.port), timeout=60)


def head(method, path, length, **headers):
    lines = [f"{method} {path} HTTP/1.1", "Host: 127.0.0.1", f"Content-Length: {length}"]
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    return "\r\n".join([*lines, "", ""]).encode()


def rest_of(connection):
    """Return what comes until the other side closes the connection."""
    with connection:
        parts = []
        while part := connection.recv(2**16):
            parts.append(part)
    return b"".join(parts)


def test_uploads_that_stop_block_nothing_and_what_was_received_is_stored(server):
    body = tar((f"{i:06}.npy", npy(scan.points_m)) for i, scan in enumerate(SCANS))
    cut = body.index(b"000004.npy") + 700
    held = [connected(server) for _ in range(HELD)]
    for connection in held:
        connection.sendall(
            head("POST", f"{DRIVE}/scans", len(body), Content_Type=TAR["Content-Type"])
        )
    held[0].sendall(body[:cut])
    assert upload_scan(server.client, "campus", "other", 0, SCANS[0]).status_code == 201
    for connection in held:
        answer = rest_of(connection)
        assert answer.startswith(b"HTTP/1.1 408 "), answer
        assert b"/problems/slow-body" in answer
        assert b"connection: close" in answer.lower()
    assert server.client.get(f"{DRIVE}/scans").json()["present"] == [{"first": 0, "last": 3}]


@pytest.mark.parametrize("path", ["drives/none/poses", "loop-closures", "drives/x/scans/0"])
def test_every_kind_of_body_has_a_time_limit(server, path):
    method = "POST" if path == "loop-closures" else "PUT"
    with connected(server) as connection:
        connection.sendall(
            head(method, f"/v1/maps/campus/{path}", 100, Content_Type="application/json") + b"{"
        )
        assert connection.recv(2**16).startswith(b"HTTP/1.1 408 ")


def test_bodies_that_still_come_when_the_service_stops_are_answered_503(tmp_path):
    log = tmp_path / "log"
    with serving(tmp_path / "data", log) as stopping, ExitStack() as open_ones:
        stopping.client.post("/v1/maps", json={"map": "campus"})
        connections = [open_ones.enter_context(connected(stopping)) for _ in range(3)]
        for connection, (method, path, kind) in zip(
            connections,
            (
                ("POST", f"{DRIVE}/scans", TAR["Content-Type"]),
                ("PUT", f"{DRIVE}/scans/0", "application/vnd.tensormap.npy"),
                ("POST", "/v1/maps", "application/json"),
            ),
            strict=True,
        ):
            connection.sendall(head(method, path, 10_000, Content_Type=kind) + b"{")
        stopping.client.get("/readyz")
        stopping.process.terminate()
        answers = [rest_of(connection) for connection in connections]
        stopping.process.wait(30)
    for answer in answers:
        assert answer.startswith(b"HTTP/1.1 503 "), answer
        assert b"content-type: application/problem+json" in answer
        assert b"/problems/service-busy" in answer
        assert b"being stopped" in answer
        assert b"retry-after: 5" in answer
    assert "Traceback" not in log.read_text()


def test_a_body_that_is_refused_unread_is_not_read_for_ever(server):
    refused = head(
        "POST", "/v1/maps/none/drives/d/scans", 64 * 2**30, Content_Type="application/x-tar"
    )
    connection = connected(server)
    connection.sendall(refused)
    began, sent, megabyte = time.monotonic(), 0, bytes(2**20)
    with connection, suppress(ConnectionError):
        while time.monotonic() - began < 60:
            sent += connection.send(megabyte)
    assert sent < 2 * 2**30


def test_a_client_that_sends_first_and_reads_later_gets_the_refusal(server):
    with connected(server) as connection:
        body = bytes(32 * 2**20)
        path = "/v1/maps/none/drives/d/scans"
        connection.sendall(head("POST", path, len(body), Content_Type="application/x-tar") + body)
        assert connection.recv(2**16).startswith(b"HTTP/1.1 404 ")


def test_work_whose_client_left_ends_and_the_next_one_is_served(server):
    upload(server.client, "loops", SCENE)
    job = server.client.post("/v1/maps/campus/builds", json={"drives": ["loops"], "segments": 1})
    assert wait_for(server.client, job.json()["job"])["state"] == "done"
    pair = [{"drive": "loops", "scan_index": index} for index in (0, 3)]
    one = {"proposals": [{"first": pair[0], "second": pair[1]}]}
    many = {"proposals": one["proposals"] * 100}
    path = "/v1/maps/campus/loop-closures"
    began = time.monotonic()
    assert server.client.post(path, json=one).status_code == 200
    one_s = time.monotonic() - began
    request = server.client.build_request("POST", path, json=many)
    sent = head("POST", path, len(request.content), Content_Type="application/json")
    for _ in range(5):
        with connected(server) as connection:
            connection.sendall(sent + request.content)
            time.sleep(one_s)
    began = time.monotonic()
    assert server.client.post(path, json=one).status_code == 200
    assert time.monotonic() - began < 100 * one_s  # five of them would take 500
    lines = server.log.read_text()
    assert "Traceback" not in lines, lines


def test_more_than_may_wait_is_refused_by_name_and_the_rest_is_answered(tmp_path):
    settings = {"heavy_threads": "1", "queued_requests": "4"}
    with serving(tmp_path / "data", tmp_path / "log", **settings) as server:
        server.client.post("/v1/maps", json={"map": "campus"})
        upload(server.client, "loops", SCENE)
        job = server.client.post("/v1/maps/campus/builds", json={"segments": 1})
        assert wait_for(server.client, job.json()["job"])["state"] == "done"
        first, second = ({"drive": "loops", "scan_index": index} for index in (0, 3))
        path = "/v1/maps/campus/loop-closures"
        many = {"proposals": [{"first": first, "second": second}] * 12}
        with ThreadPoolExecutor(12) as pool:
            answers = list(pool.map(lambda _: server.client.post(path, json=many), range(12)))
        refused = [answer for answer in answers if answer.status_code != 200]
        assert refused
        assert len(refused) <= 12 - 1 - 2  # one runs, and two of a key wait
        for answer in refused:
            assert problem_of(answer) == (429, "too-many-requests")
            assert answer.headers["Retry-After"] == "2"
