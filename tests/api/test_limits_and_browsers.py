"""Rate limits, and what a browser allows the pages of other sites."""

import asyncio
from unittest.mock import Mock

import pytest
from starlette.testclient import TestClient, WebSocketDenialResponse
from starlette.websockets import WebSocketDisconnect

from app.settings import Settings
from tests.support.access import ADMIN, ADMIN_KEY, bearer, make
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import copy_of, problem_of, running

SITE = "https://maps.example"
PREFLIGHT = {
    "Access-Control-Request-Method": "PUT",
    "Access-Control-Request-Headers": "authorization, content-type",
}


# How often


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    """Five requests at once, and then one in a thousand seconds."""
    folder = tmp_path_factory.mktemp("limited")
    with running(folder, admin_key=ADMIN_KEY, requests_per_s=0.001, request_burst=5) as client:
        yield client


def test_a_key_beyond_its_limit_gets_a_time_to_retry_and_others_do_not(limited):
    one, other = (bearer(make(limited, "maps:read")["secret"]) for _ in range(2))
    answers = [limited.get("/v1/maps", headers=one) for _ in range(6)]
    assert [answer.status_code for answer in answers] == [200] * 5 + [429]
    assert [answer.headers["RateLimit"].split(";")[1] for answer in answers[:5]] == [
        f"r={left}" for left in (4, 3, 2, 1, 0)
    ]
    refused = answers[5]
    assert problem_of(refused) == (429, "too-many-requests")
    assert 900 < int(refused.headers["Retry-After"]) <= 1000
    assert refused.headers["RateLimit-Policy"] == '"requests";q=5;w=5000'
    assert refused.headers["RateLimit"].startswith('"requests";r=0;t=')
    assert limited.get("/v1/maps", headers=other).status_code == 200
    # Requests of a proxy or an orchestrator have no key.
    assert all(limited.get("/livez").status_code == 200 for _ in range(10))
    assert "RateLimit" not in limited.get("/livez").headers


def test_an_address_that_guesses_keys_is_slowed_down_and_key_holders_there_are_not(limited):
    held = bearer(make(limited, "maps:read")["secret"])
    guesses = [limited.get("/v1/maps", headers=bearer(f"guess {n}")) for n in range(7)]
    assert [guess.status_code for guess in guesses] == [401] * 5 + [429] * 2
    assert problem_of(limited.get("/v1/maps")) == (429, "too-many-requests")
    assert limited.get("/v1/maps", headers=held).status_code == 200


def test_without_keys_an_address_counts(tmp_path):
    with running(tmp_path, requests_per_s=0.001, request_burst=2) as client:
        requested = [client.get("/v1/maps").status_code for _ in range(3)]
    assert requested == [200, 200, 429]


def test_messages_of_a_stream_count_and_it_continues(tmp_path, built):
    limits = {"requests_per_s": 0.001, "request_burst": 4}
    data_dir = copy_of(built.data_dir, tmp_path / "data")
    with running(data_dir, admin_key=ADMIN_KEY, **limits) as client:
        vehicle = bearer(make(client, "localize")["secret"])
        track = client.post("/v1/maps/campus/tracks", headers=vehicle).headers["Location"]
        with client.websocket_connect(f"{track}/stream", headers=vehicle) as stream:
            answer = []
            for _ in range(4):
                stream.send_text("{}")
                problem = stream.receive_json()
                answer.append(problem["type"])
        assert problem["retry_after_s"] > 100  # a message has no Retry-After
        assert answer == ["/problems/invalid-request"] * 2 + ["/problems/too-many-requests"] * 2
        with (
            pytest.raises(WebSocketDenialResponse) as refused,
            client.websocket_connect(f"{track}/stream", headers=vehicle),
        ):
            pass
        assert refused.value.status_code == 429


def test_bytes_of_a_streams_messages_count_and_it_continues(tmp_path, built):
    data_dir = copy_of(built.data_dir, tmp_path / "data")
    with running(data_dir, admin_key=ADMIN_KEY, upload_bytes_per_day=1000) as client:
        vehicle = bearer(make(client, "localize")["secret"])
        track = client.post("/v1/maps/campus/tracks", headers=vehicle).headers["Location"]
        with client.websocket_connect(f"{track}/stream", headers=vehicle) as stream:
            answers = []
            for message in ("{" + " " * 400, bytes(500), "é" * 80, bytes(90)):
                if isinstance(message, str):
                    stream.send_text(message)
                else:
                    stream.send_bytes(message)
                problem = stream.receive_json()
                answers.append(problem["type"].removeprefix("/problems/"))
            assert answers == [
                *("invalid-request", "invalid-signature", "too-many-requests", "invalid-signature")
            ]
            stream.send_bytes(bytes(500))
            refused = stream.receive_json()
            assert refused["retry_after_s"] > 1000
            assert "1000 bytes" in refused["detail"]
            stream.send_bytes(bytes(1001))  # never allowed
            assert stream.receive_json()["type"] == "/problems/body-too-large"
            with pytest.raises(WebSocketDisconnect) as closed:
                stream.receive_json()
        assert closed.value.code == 1009


@pytest.fixture
def metered(tmp_path):
    """Ten thousand bytes a day, and a map to put scans into."""
    with running(tmp_path, admin_key=ADMIN_KEY, upload_bytes_per_day=10_000) as client:
        assert client.post("/v1/maps", json={"map": "campus"}, headers=ADMIN).status_code == 201
        yield client


def put_scan(client, key, index, body):
    path = f"/v1/maps/campus/drives/monday/scans/{index}"
    return client.put(path, content=body, headers={**KITTI, **key})


def test_the_bytes_of_a_key_per_day_are_limited(metered):
    one, other = (bearer(make(metered, "maps:write")["secret"]) for _ in range(2))
    scan = kitti(recording().scans[0])[:4800]
    assert put_scan(metered, one, 0, scan).status_code == 201
    second = put_scan(metered, one, 1, scan)
    assert second.headers["RateLimit-Policy"] == '"bytes";q=10000;qu="content-bytes";w=86400'
    assert second.headers["RateLimit"].startswith('"bytes";r=400;t=')
    refused = put_scan(metered, one, 2, scan)
    assert problem_of(refused) == (429, "too-many-requests")
    assert 37_000 < int(refused.headers["Retry-After"]) <= 38_016  # for 4,400 of them
    assert put_scan(metered, other, 2, scan).status_code == 201
    drive = metered.get("/v1/maps/campus/drives/monday", headers=one)
    assert (drive.status_code, drive.json()["scans"]) == (200, 3)  # a GET sends no bytes


def test_bytes_that_were_not_announced_count_as_they_come(metered):
    one = bearer(make(metered, "maps:write")["secret"])
    scan = kitti(recording().scans[0])[:6400]
    assert put_scan(metered, one, 0, iter([scan[:3200], scan[3200:]])).status_code == 201
    refused = put_scan(metered, one, 1, iter([scan[:3200], scan[3200:]]))
    assert problem_of(refused) == (429, "too-many-requests")
    drive = metered.get("/v1/maps/campus/drives/monday", headers=one)
    assert drive.json()["scans"] == 1


def test_a_body_larger_than_the_limit_per_day_is_too_large(metered):
    one = bearer(make(metered, "maps:write")["secret"])
    refused = put_scan(metered, one, 0, bytes(16_000))
    assert problem_of(refused) == (413, "body-too-large")
    assert "send it in parts" in refused.json()["detail"]


def test_a_body_that_was_not_announced_is_too_large_once_it_exceeds_the_limit_per_day(metered):
    one = bearer(make(metered, "maps:write")["secret"])
    refused = put_scan(metered, one, 0, iter([bytes(8000), bytes(8000)]))
    assert problem_of(refused) == (413, "body-too-large")
    assert "16000 bytes or more" in refused.json()["detail"]
    drives = metered.get("/v1/maps/campus/drives", headers=one)
    assert drives.json()["items"] == []


def test_by_default_nothing_is_limited(client):
    assert "RateLimit" not in client.get("/v1/maps").headers


# Browsers


def test_by_default_no_page_elsewhere_reads_an_answer(tmp_path):
    with running(tmp_path, admin_key=ADMIN_KEY) as client:
        for headers in ({"Origin": SITE}, {"Origin": "null"}, {"Origin": "http://localhost:3000"}):
            answer = client.get("/v1/maps", headers={**ADMIN, **headers})
            assert not any(name.startswith("access-control") for name in answer.headers)
            preflight = client.options("/v1/maps", headers={**headers, **PREFLIGHT})
            assert preflight.status_code == 401
            assert not any(name.startswith("access-control") for name in preflight.headers)


def test_pages_of_an_allowed_origin_may_send_requests_with_a_key_and_without_cookies(tmp_path):
    with running(tmp_path, admin_key=ADMIN_KEY, allowed_origins=(SITE,)) as client:
        preflight = client.options("/v1/maps", headers={"Origin": SITE, **PREFLIGHT})
        assert preflight.status_code == 200
        assert preflight.headers["Access-Control-Allow-Origin"] == SITE
        answer = client.get("/v1/maps", headers={**ADMIN, "Origin": SITE})
        assert answer.headers["Access-Control-Allow-Origin"] == SITE
        for header in ("Retry-After", "TensorMap-Least-Cells"):
            assert header in answer.headers["Access-Control-Expose-Headers"]
        for shown in (preflight, answer):
            assert "Access-Control-Allow-Credentials" not in shown.headers
            assert "Origin" in shown.headers["Vary"]
        assert "Authorization" in answer.headers["Vary"]
        refused = client.get("/v1/maps", headers={"Origin": SITE})
        assert problem_of(refused) == (401, "key-needed")
        assert refused.headers["Access-Control-Allow-Origin"] == SITE


@pytest.mark.parametrize(
    ("fault", "answered"),
    [
        (ZeroDivisionError(), (500, "internal-error")),
        (asyncio.CancelledError(), (503, "service-busy")),  # as at the end of a stop
    ],
)
def test_pages_of_an_allowed_origin_read_that_a_request_failed(
    tmp_path, monkeypatch, fault, answered
):
    with running(tmp_path, admin_key=ADMIN_KEY, allowed_origins=(SITE,)) as client:
        monkeypatch.setattr(client.service.store.maps, "get", Mock(side_effect=fault))
        failed = client.get("/v1/maps/campus", headers={**ADMIN, "Origin": SITE})
        assert problem_of(failed) == answered
        assert failed.headers["Access-Control-Allow-Origin"] == SITE


def test_pages_of_an_allowed_origin_may_name_requests_pack_bodies_and_read_parts_of_files(tmp_path):
    with running(tmp_path, admin_key=ADMIN_KEY, allowed_origins=(SITE,)) as client:
        sent = {"Origin": SITE, **PREFLIGHT}
        sent["Access-Control-Request-Headers"] = (
            "authorization,content-encoding,range,if-range,x-request-id"
        )
        preflight = client.options("/v1/maps", headers=sent)
        assert preflight.status_code == 200, preflight.text
        answer = client.get("/v1/maps", headers={**ADMIN, "Origin": SITE})
        exposed = answer.headers["Access-Control-Expose-Headers"].split(", ")
        assert {"Content-Range", "Content-Disposition", "X-Request-Id"} <= set(exposed)


def test_pages_of_other_origins_may_not_send_requests(tmp_path):
    others = (
        "https://maps.example.evil.example",
        "https://evil.example",
        "http://maps.example",
        "https://maps.example:444",
        "https://sub.maps.example",
        "https://mapsxexample",
        "null",
        "*",
    )
    with running(tmp_path, admin_key=ADMIN_KEY, allowed_origins=(SITE,)) as client:
        for origin in others:
            answer = client.get("/v1/maps", headers={**ADMIN, "Origin": origin})
            assert "Access-Control-Allow-Origin" not in answer.headers, origin
            # Starlette answers a preflight in plain text, which only a browser reads.
            headers = {"Origin": origin, **PREFLIGHT}
            preflight = TestClient.request(client, "OPTIONS", "/v1/maps", headers=headers)
            assert preflight.status_code == 400
            assert "Access-Control-Allow-Origin" not in preflight.headers, origin


def test_without_keys_a_page_elsewhere_changes_nothing(tmp_path):
    with running(tmp_path) as client:
        client.post("/v1/maps", json={"map": "campus"})
        for origin in (SITE, "null", "https://127.0.0.1.evil.example", "[", ""):
            # A browser sends such requests, without a preflight, to whatever host a page names.
            simple = {"Origin": origin, "Content-Type": "text/plain"}
            for path in ("/v1/maps/campus/tracks", "/v1/maps/campus/localizations/scan"):
                refused = client.post(path, content=b"{}", headers=simple)
                assert problem_of(refused) == (421, "host-not-allowed"), (path, origin)
            refused = client.post("/v1/maps", content=b'{"map": "theirs"}', headers=simple)
            assert problem_of(refused)[0] in {415, 421}
            refused = client.get("/v1/maps", headers=simple)
            assert problem_of(refused) == (421, "host-not-allowed")
        assert len(client.get("/v1/maps").json()["items"]) == 1
        assert client.get("/v1/maps", headers={"Origin": "http://localhost:8000"}).is_success
    with running(tmp_path, allowed_origins=(SITE,)) as client:
        assert client.get("/v1/maps", headers={"Origin": SITE}).is_success


@pytest.mark.parametrize(
    "given",
    [
        "*",
        "maps.example",
        f"{SITE}/",
        f"{SITE}/x",
        "https://*.example",
        "null",
        "https://A.example",
        "file://",
    ],
)
def test_an_invalid_origin_is_rejected_at_the_start(given):
    with pytest.raises(ValueError, match="wanted origins"):
        Settings(allowed_origins=given)


def test_origins_are_read_from_the_environment(monkeypatch):
    monkeypatch.setenv("TENSORMAP_ALLOWED_ORIGINS", f"{SITE}, http://[::1]:3000")
    assert Settings().allowed_origins == (SITE, "http://[::1]:3000")
    monkeypatch.setenv("TENSORMAP_ALLOWED_ORIGINS", "")
    assert Settings().allowed_origins == ()


@pytest.mark.parametrize("path", ["/v1/maps", "/v1/maps/nowhere", "/docs", "/livez", "/none"])
def test_every_answer_has_the_headers_that_protect_browsers(client, path):
    answer = client.get(path).headers
    assert answer["X-Content-Type-Options"] == "nosniff"
    assert answer["Content-Security-Policy"] == "frame-ancestors 'none'"
    assert answer["Cross-Origin-Resource-Policy"] == "same-origin"
    assert answer["Referrer-Policy"] == "no-referrer"


def test_no_cache_gives_an_answer_to_another_caller_or_an_old_one(tmp_path):
    with running(tmp_path, admin_key=ADMIN_KEY) as client:
        made = client.post("/v1/maps", json={"map": "campus"}, headers=ADMIN)
        answers = [
            client.get("/v1/maps/campus", headers=ADMIN),
            client.head("/v1/maps/campus", headers=ADMIN),
            client.get("/v1/maps/nowhere", headers=ADMIN),
            client.get("/v1/maps"),
            client.get("/metrics", headers=ADMIN),
        ]
        assert [answer.status_code for answer in answers] == [200, 200, 404, 401, 200]
        for answer in answers:
            assert answer.headers["Cache-Control"] == "private, no-cache"
            assert answer.headers["Vary"] == "Authorization"
        for answer in (made, client.get("/livez"), client.get("/openapi.json")):
            assert "private" not in answer.headers.get("Cache-Control", "")
            assert "Authorization" not in answer.headers.get("Vary", "")
