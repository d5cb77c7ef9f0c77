"""Every answer has an id, which the log contains too."""

import io
import json
import logging

import pytest

from app.http.logs import LineFormatter
from app.settings import LogFormat
from tests.support.recording import KITTI, recording, upload_scan
from tests.support.service import problem_of, running


@pytest.fixture
def logged():
    """What the service logs while a test runs, as JSON."""
    written = io.StringIO()
    handler = logging.StreamHandler(written)
    handler.setFormatter(LineFormatter(LogFormat.JSON))
    logger = logging.getLogger("tensormap")
    kept = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    yield lambda: [json.loads(line) for line in written.getvalue().splitlines()]
    logger.removeHandler(handler)
    logger.setLevel(kept)


def requests(lines):
    return [line for line in lines if line["event"] == "request"]


def test_an_id_that_was_sent_is_returned_and_logged(own, logged):
    headers = {"X-Request-Id": "truck-7:42"}
    answer = own.get("/v1/maps/campus", headers=headers)
    assert answer.headers["X-Request-Id"] == "truck-7:42"
    [line] = requests(logged())
    assert line["request_id"] == "truck-7:42"
    assert (line["method"], line["path"], line["route"], line["status"]) == (
        "GET",
        "/v1/maps/campus",
        "/v1/maps/{map}",
        200,
    )
    assert line["seconds"] > 0
    assert line["client"] == "127.0.0.1"


def test_every_request_has_an_id_of_its_own_and_each_problem_contains_it(own, logged):
    requested = [
        own.get("/v1/maps/nowhere"),
        own.get("/nothing"),
        own.post("/livez"),
        own.post("/v1/maps", json={"map": 3}),
        own.post("/v1/maps", content=b"{", headers={"Content-Encoding": "br"}),
        own.put("/v1/maps/campus/drives/monday/scans/0", content=b"x", headers=KITTI),
        own.get("/v1/maps", headers={"X-Request-Id": "not sane\n"[:-1]}),
    ]
    ids = [answer.headers["X-Request-Id"] for answer in requested]
    assert len(set(ids)) == len(requested)
    for answer in requested[:-1]:
        assert answer.status_code >= 400
        assert answer.json()["request_id"] == answer.headers["X-Request-Id"]
    assert [line["request_id"] for line in requests(logged())] == ids


def test_a_fault_is_logged_with_its_traceback_under_the_requests_id(own, logged, monkeypatch):
    def fall_over(*_, **__):
        raise ZeroDivisionError("not foreseen")

    monkeypatch.setattr("app.maps.routes.page_out", fall_over)
    failed = own.get("/v1/maps")
    assert problem_of(failed) == (500, "internal-error")
    fault, request = logged()
    assert fault["request_id"] == request["request_id"] == failed.json()["request_id"]
    assert "not foreseen" in fault["traceback"]
    assert request["status"] == 500
    assert failed.headers["X-Content-Type-Options"] == "nosniff"  # as every answer has it


def test_neither_keys_nor_bodies_nor_queries_are_logged(tmp_path, logged):
    key = "tm_0a1b2c3d_" + "s3cret" * 7
    with running(tmp_path / "data", admin_key=key) as client:
        good = {"Authorization": f"Bearer {key}"}
        bad = {"Authorization": "Bearer wr0ng-wr0ng-wr0ng"}
        client.post("/v1/maps", json={"map": "campus", "description": "b0dy"}, headers=good)
        client.get("/v1/maps", params={"token": "qu3ry"}, headers=good)
        client.get("/v1/maps", headers=bad)
        client.get(f"/v1/maps/{key}", headers=bad)
        client.post("/v1/maps", content=b'{"map": "b0dy', headers=good | JSON)
    answer = json.dumps(logged())
    assert len(requests(logged())) == 5
    for secret in ("s3cret", "wr0ng", "b0dy", "qu3ry"):
        assert secret not in answer


JSON = {"Content-Type": "application/json"}


def test_a_stream_is_logged_once_with_its_route(own, logged):
    track = own.post("/v1/maps/campus/tracks").json()["track"]
    with own.websocket_connect(f"ws://127.0.0.1/v1/maps/campus/tracks/{track}/stream"):
        pass
    [stream] = [line for line in logged() if line["event"] == "stream"]
    assert stream["route"] == "/v1/maps/{map}/tracks/{track}/stream"
    assert (stream["status"], stream["key"]) == (101, "everyone")
    assert stream["request_id"]


def test_the_scan_that_is_stored_is_one_line(own, logged):
    upload_scan(own, "campus", "monday", 900, recording().scans[0])
    [line] = logged()
    assert (line["status"], line["method"]) == (201, "PUT")


def test_a_refused_request_has_the_name_of_its_problem_in_its_line_and_no_other_has(own, logged):
    assert problem_of(own.get("/v1/maps/nowhere")) == (404, "map-not-found")
    own.get("/v1/maps/campus")
    refused, answered = requests(logged())
    assert (refused["status"], refused["problem"]) == (404, "map-not-found")
    assert "problem" not in answered


def test_a_path_is_one_word_of_a_line_and_adds_no_fields_to_it(own, logged, caplog):
    caplog.set_level(logging.INFO)
    own.get("/v1/maps/a%20status=200%20key=operator%0Ab")
    [line] = requests(logged())
    assert line["path"] == "/v1/maps/a%20status%3D200%20key%3Doperator%0Ab"
    [record] = [record for record in caplog.records if record.name == "tensormap.requests"]
    words = LineFormatter(LogFormat.TEXT).format(record).split()
    assert [word for word in words if word.startswith("key=")] == ["key=everyone"]
