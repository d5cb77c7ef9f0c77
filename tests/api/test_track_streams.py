"""A track's WebSocket: a vehicle's observations, one after another."""

import math
import struct
import threading

import pytest
from starlette.testclient import WebSocketDenialResponse
from starlette.websockets import WebSocketDisconnect

from app.http.answer_headers import LAST_SEQUENCE
from app.http.pools import Pool
from core.encodings.signature import pack_signatures
from tests.support.access import ADMIN_KEY
from tests.support.service import copy_of, problem_of, running
from tests.support.tracks import TRACKS, as_json, open_stream, signed


@pytest.fixture(scope="module", params=["paper", "harmonic"])
def client(tmp_path_factory, campus_of, request):
    built = campus_of(segments=3, encoding=request.param)
    data_dir = copy_of(built, tmp_path_factory.mktemp("tracks") / "data")
    with running(data_dir, max_tracks=40) as client:
        yield client


def test_a_stream_answers_each_packed_signature(client, basis, track):
    with open_stream(client, f"{track}/stream") as stream:
        for index in range(6):
            stream.send_bytes(pack_signatures(signed(basis, index)))
            answer = stream.receive_json()
            assert answer["observations"] == index + 1
    assert abs(answer["scan_index"] - 5) <= 1
    assert client.get(track).json()["last"] == answer


def test_a_quick_observation_of_a_stream_needs_no_thread_and_is_taken_once(
    client, basis, track, monkeypatch
):
    run, begun, answered = Pool.run_here, [], []

    async def counted(pool, key, work):
        begun.append(key)
        answer = await run(pool, key, work)
        answered.append(key)
        return answer

    monkeypatch.setattr(Pool, "run_here", counted)
    monkeypatch.setattr("app.quick_work._QUICK_S", 60.0)
    with open_stream(client, f"{track}/stream") as stream:
        for index in range(8):
            if index == 4:  # what is kept of the catalog has to be read again, in a thread
                client.patch("/v1/maps/campus", json={"description": "changed"}).raise_for_status()
            stream.send_bytes(pack_signatures(signed(basis, index)))
            assert stream.receive_json()["observations"] == index + 1
    assert len(begun) == 8
    assert 4 <= len(answered) < 7  # the first one never is


def test_the_event_loop_does_not_wait_for_a_track_that_another_observation_holds(
    client, basis, track, monkeypatch
):
    run, still_held = Pool.run_here, []

    async def overtaken(pool, key, work):
        """Run it when a thread has the track, as one that was faster while this one waited."""
        held = client.service.tracks._tracks[track.rpartition("/")[2]]._lock
        held.acquire()
        release = threading.Timer(1.0, held.release)  # or it would wait for good
        release.start()
        try:
            return await run(pool, key, work)
        finally:
            still_held.append(held.locked())
            if held.locked():
                release.cancel()
                held.release()

    monkeypatch.setattr(Pool, "run_here", overtaken)
    monkeypatch.setattr("app.quick_work._QUICK_S", 60.0)
    with open_stream(client, f"{track}/stream") as stream:
        for index in range(2):
            stream.send_bytes(pack_signatures(signed(basis, index)))
            assert stream.receive_json()["observations"] == index + 1
    assert still_held == [True, True]


def test_a_message_of_more_than_a_kibibyte_is_not_read_on_the_event_loop(
    client, track, monkeypatch
):
    """64 KiB of JSON take 0.14 s, of packed signatures 0.6 s; nobody else gets an answer then."""
    run, begun = Pool.run_here, []
    sent: str | bytes

    async def noted(pool, key, work):
        begun.append(len(sent))
        return await run(pool, key, work)

    monkeypatch.setattr(Pool, "run_here", noted)
    with open_stream(client, f"{track}/stream") as stream:
        for sent in ("{" + " " * 1022 + "}", "{" + " " * 1023 + "}", "{" + " " * 60_000 + "}"):
            stream.send_text(sent)
            assert stream.receive_json()["type"] == "/problems/invalid-request"
        for sent in (b"\1" + bytes(1023), b"\1" + bytes(1024), b"\1" + bytes(60_000)):
            stream.send_bytes(sent)
            assert stream.receive_json()["type"] == "/problems/invalid-signature"
    assert begun == [1024, 1024]


def test_a_stream_takes_json_and_continues_after_a_rejection(client, basis, track):
    with open_stream(client, f"{track}/stream") as stream:
        stream.send_json({**as_json(signed(basis, 0)), "sequence": 3, "timestamp_s": 1.0})
        assert stream.receive_json()["observations"] == 1
        stream.send_json({**as_json(signed(basis, 1)), "sequence": 3})
        assert stream.receive_json()["type"] == "/problems/stale-observation"
        for nonsense in ("{", '{"revision": 1}', "[]", ""):
            stream.send_text(nonsense)
            problem = stream.receive_json()
            assert problem["type"] == "/problems/invalid-request"
        assert "is no JSON" in problem["detail"]
        stream.send_bytes(b"")
        assert stream.receive_json()["type"] == "/problems/invalid-signature"
        stream.send_bytes(pack_signatures(signed(basis, 1)))
        assert stream.receive_json()["observations"] == 2


def test_the_last_number_that_an_opened_stream_names_skips_observations_without_one(
    client, basis, track
):
    numbers = []
    for message in ({}, {"sequence": 7}, {}):
        with open_stream(client, f"{track}/stream") as stream:
            numbers += [dict(stream.extra_headers)[LAST_SEQUENCE.lower().encode()]]
            stream.send_json({**as_json(signed(basis, len(numbers))), **message})
            assert stream.receive_json()["observations"] == len(numbers)
    with open_stream(client, f"{track}/stream") as stream:
        numbers += [dict(stream.extra_headers)[LAST_SEQUENCE.lower().encode()]]
    assert numbers == [b"none", b"none", b"7", b"7"]


def test_a_rejected_packed_message_has_its_number_and_time_whatever_is_wrong_with_it(
    client, basis, track
):
    packed = pack_signatures(signed(basis, 0))
    stale = packed[:1] + bytes(8) + packed[9:]
    nan, inf = math.nan, math.inf
    with open_stream(client, f"{track}/stream") as stream:
        for number, (time_s, travelled_m, sent) in enumerate(
            [(0.5, 1.0, packed[:-1]), (nan, nan, b""), (0.5, nan, stale), (0.5, inf, packed)]
        ):
            stream.send_bytes(struct.pack("<BQdd", 64, number, time_s, travelled_m) + sent)
            answer = stream.receive_json()
            assert answer["status"] in {409, 422}
            known_s = None if math.isnan(time_s) else time_s
            assert (answer["sequence"], answer["timestamp_s"]) == (number, known_s)
        for number, time_s in ((2**53, 0.5), (5, inf)):
            stream.send_bytes(struct.pack("<BQdd", 64, number, time_s, nan) + packed)
            answer = stream.receive_json()
            assert answer["sequence"] == (5 if number == 5 else None)
            assert answer["timestamp_s"] == (0.5 if time_s == 0.5 else None)


def test_rejected_json_has_its_number_and_time_if_they_could_be_read(client, basis, track):
    wrong = {**as_json(signed(basis, 0)), "travelled_m": "far"}
    with open_stream(client, f"{track}/stream") as stream:
        for number, time_s, known in (
            (7, 0.5, (7, 0.5)),
            (8, None, (8, None)),
            (2**53, 1e12, (None, None)),
            (-1, 10**400, (None, None)),
            ("9", "now", (None, None)),
            (True, None, (None, None)),
        ):
            stream.send_json({**wrong, "sequence": number, "timestamp_s": time_s})
            answer = stream.receive_json()
            assert answer["type"] == "/problems/invalid-request"
            assert (answer["sequence"], answer["timestamp_s"]) == known
        for unread in ("{", "[]"):
            stream.send_text(unread)
            assert "sequence" not in stream.receive_json()


def test_another_websocket_than_a_stream_is_no_route(client, track):
    for path in (f"{track}/streams", "/v1/maps", "/"):
        with pytest.raises(WebSocketDenialResponse) as refused, open_stream(client, path):
            pass
        assert problem_of(refused.value) == (404, "no-such-route")
        assert f"there is no WebSocket {path}" in refused.value.json()["detail"]


def test_a_stream_of_an_unknown_track_is_refused_before_it_opens(client):
    with (
        pytest.raises(WebSocketDenialResponse) as refused,
        open_stream(client, f"{TRACKS}/none/stream"),
    ):
        pass
    assert refused.value.status_code == 404
    assert refused.value.json()["type"] == "/problems/track-not-found"


def test_a_stream_ends_with_its_track(client, basis, track):
    with open_stream(client, f"{track}/stream") as stream:
        client.delete(track)
        stream.send_bytes(pack_signatures(signed(basis, 0)))
        assert stream.receive_json()["type"] == "/problems/track-not-found"
        with pytest.raises(WebSocketDisconnect) as closed:
            stream.receive_json()
    assert closed.value.code == 1008


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "maps.example"},
        {"Origin": "https://maps.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1.maps.example"},
    ],
)
def test_a_page_of_another_origin_cannot_open_a_stream_of_an_open_service(client, track, headers):
    with (
        pytest.raises(WebSocketDenialResponse) as refused,
        open_stream(client, f"{track}/stream", headers=headers),
    ):
        pass
    assert refused.value.status_code == 421
    assert refused.value.json()["type"] == "/problems/host-not-allowed"


def test_a_page_of_this_machine_can_open_a_stream(client, track):
    headers = {"Origin": "http://localhost:8000"}
    with open_stream(client, f"{track}/stream", headers=headers):
        pass


def test_a_stream_without_the_key_is_refused_before_it_opens(tmp_path):
    with running(tmp_path / "data", admin_key=ADMIN_KEY) as client:
        for headers, name in (
            ({}, "key-needed"),
            ({"Authorization": f"Basic {ADMIN_KEY}"}, "key-needed"),
            ({"Authorization": f"Bearer {ADMIN_KEY}x"}, "key-refused"),
            ({"Authorization": f"Bearer {ADMIN_KEY}"}, "map-not-found"),
        ):
            with (
                pytest.raises(WebSocketDenialResponse) as refused,
                open_stream(client, f"{TRACKS}/none/stream", headers=headers),
            ):
                pass
            assert refused.value.json()["type"] == f"/problems/{name}"


def test_a_stream_that_is_requested_over_http_is_426_and_names_the_websocket(client):
    # As through a proxy that drops `Upgrade`, whatever the track.
    for track in ("none", client.post(TRACKS).json()["track"]):
        for query in ("", "?fields=localized,pose"):  # as a stream may have it
            refused = client.get(f"{TRACKS}/{track}/stream{query}")
            assert problem_of(refused) == (426, "upgrade-required")
            assert "WebSocket" in refused.json()["detail"]
            assert refused.headers["Upgrade"] == "websocket"
    posted = client.post(f"{TRACKS}/none/stream")
    assert problem_of(posted) == (405, "method-not-allowed")
    assert posted.headers["Allow"] == "GET, HEAD"


def test_the_description_of_a_stream_has_its_parameters_and_what_may_refuse_it(client):
    paths = client.documented["paths"]
    described = paths["/v1/maps/{map}/tracks/{track}/stream"]["get"]
    assert {"map", "track", "fields"} == {each["name"] for each in described["parameters"]}
    refusals = {
        name
        for answer in described["responses"].values()
        for content in answer.get("content", {}).values()
        for name in content["examples"]
    }
    assert {
        "map-not-found",
        "track-not-found",
        "revision-not-found",
        "too-many-streams",
        "too-many-streams-of-key",
        "invalid-request",
        "key-refused",
    } <= refusals


def test_a_message_that_is_no_observation_is_answered_in_words_of_the_api(client):
    track = client.post(TRACKS).json()["track"]
    with open_stream(client, f"{TRACKS}/{track}/stream") as stream:
        for message, detail in (
            ("[]", "the message: should be an object, got a list"),
            ("{", "the message: is no JSON: Expecting property name"),
            ('{"signatures": [], "sequence": -1}', "signatures: should have at least 1 item"),
        ):
            stream.send_text(message)
            assert stream.receive_json()["detail"].startswith(detail)
