"""Tracks over HTTP and over a stream: a vehicle's observations, one after another."""

import math
import struct
import threading

import numpy as np
import pytest
from starlette.testclient import WebSocketDenialResponse
from starlette.websockets import WebSocketDisconnect

from app.http.pools import Pool
from app.revisions.schemas import BasisOut
from core.encodings.signature import pack_signatures
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import problem_of, running, upload, wait_for

PACKED = {"Content-Type": "application/vnd.tensormap.signature"}
IMAGE = {"Content-Type": "application/vnd.tensormap.image"}
TRACKS = "/v1/maps/campus/tracks"
KEY = "correct horse battery staple"


def fill(client, encoding):
    client.post("/v1/maps", json={"map": "campus"})
    upload(client, "monday", recording())
    parameters = {"segments": 3, "encoding": encoding}
    queued = client.post("/v1/maps/campus/builds", json=parameters)
    assert wait_for(client, queued.json()["job"])["state"] == "done"


@pytest.fixture(scope="module", params=["paper", "harmonic"])
def client(tmp_path_factory, request):
    with running(tmp_path_factory.mktemp("tracks") / "data", max_tracks=40) as client:
        fill(client, request.param)
        yield client


@pytest.fixture(scope="module")
def basis(client):
    return BasisOut.model_validate(client.get("/v1/maps/campus/basis").json()).to_core()


@pytest.fixture
def track(client):
    created = client.post(TRACKS)
    assert created.status_code == 201, created.text
    assert created.headers["Location"] == f"{TRACKS}/{created.json()['track']}"
    yield created.headers["Location"]
    client.delete(created.headers["Location"])


def observe(client, track, index, **params):
    scan = recording(noise_seed=7).scans[index]
    answer = client.post(f"{track}/observations", content=kitti(scan), headers=KITTI, params=params)
    assert answer.status_code == 200, answer.text
    return answer.json()


def signatures(basis, index):
    return basis.encode(basis.image(recording(noise_seed=7).scans[index]))


def open_stream(client, path, **options):
    # Starlette's client goes to its own name otherwise, whatever its base URL.
    return client.websocket_connect(f"ws://127.0.0.1{path}", **options)


def as_json(signatures):
    shown = [
        {"segment": s.segment, "values": s.values.tolist()}
        if s.segment is not None
        else {
            "values_real": s.values.real.tolist(),
            "values_imag": s.values.imag.tolist(),
            "hidden": list(s.view.hidden),
        }
        for s in signatures
    ]
    return {"revision": signatures[0].revision, "signatures": shown}


def test_a_drive_is_tracked_scan_by_scan(client, track):
    answers = [observe(client, track, index, timestamp_s=0.1 * index) for index in range(16)]
    assert [a["observations"] for a in answers] == list(range(1, 17))
    assert (answers[0]["localized"], answers[0]["reason"]) == (False, "converging")
    assert answers[-1]["localized"]
    assert answers[-1]["reason"] is None
    assert all(abs(a["scan_index"] - i) <= 1 for i, a in enumerate(answers) if a["localized"])
    last = answers[-1]
    assert last["direction"] == "along"
    assert not last["standing"]
    assert last["probability"] > 0.9
    assert 0.0 <= last["fraction"] <= 1.0
    assert last["along_variance_m2"] == pytest.approx(last["along_sigma_m"] ** 2)
    true = recording().pose(15)
    assert np.hypot(last["pose"]["x_m"] - true.x_m, last["pose"]["y_m"] - true.y_m) < 3.0
    shown = client.get(track).json()
    assert shown["last"] == last
    assert shown["revision"] == shown["live_revision"] == last["revision"]


def test_scan_image_and_signatures_of_either_form_get_the_same_answer(client, basis):
    ways = {
        "scan": lambda i: {"content": kitti(recording(noise_seed=7).scans[i]), "headers": KITTI},
        "image": lambda i: {
            "content": basis.image(recording(noise_seed=7).scans[i]).cells.astype("<f4").tobytes(),
            "headers": IMAGE,
        },
        "json": lambda i: {"json": as_json(signatures(basis, i))},
    }
    answers = []
    for way in ways.values():
        track = client.post(TRACKS).headers["Location"]
        steps = [client.post(f"{track}/observations", **way(i)).json() for i in range(5)]
        answers.append([{**step, "track": ""} for step in steps])
        client.delete(track)
    assert answers[0] == answers[1]
    by_scan, by_signature = answers[0], answers[2]
    for one, two in zip(by_scan, by_signature, strict=True):
        differ = {name for name in one if one[name] != two[name]}
        # In a map with verification images the pose of a scan is of more than its signature.
        assert differ <= {"pose", "heading_deg", "lateral_m", "turn_deg"}, differ


def test_a_packed_signature_is_an_observation_too(client, basis, track):
    for index in range(6):
        body = pack_signatures(signatures(basis, index))
        answer = client.post(f"{track}/observations", content=body, headers=PACKED)
        assert answer.status_code == 200, answer.text
    assert abs(answer.json()["scan_index"] - 5) <= 1


def test_a_repeated_or_older_observation_is_refused_and_changes_nothing(client, track):
    observe(client, track, 0, timestamp_s=1.0, sequence=4)
    before = client.get(track).json()
    scan = {"content": kitti(recording().scans[1]), "headers": KITTI}
    for stale in ({"timestamp_s": 1.0}, {"timestamp_s": 0.5}, {"sequence": 4}, {"sequence": 0}):
        refused = client.post(f"{track}/observations", params=stale, **scan)
        assert problem_of(refused) == (409, "stale-observation")
    assert client.get(track).json() == before
    assert observe(client, track, 1, timestamp_s=1.1, sequence=5)["observations"] == 2


def test_an_observation_without_time_and_number_counts_each_time_it_is_sent(client, track):
    assert [observe(client, track, 0)["observations"] for _ in range(2)] == [1, 2]


@pytest.mark.parametrize(
    ("name", "odd"),
    [
        ("timestamp_s", 1_679_000_000_000_000_000),  # nanoseconds since 1970
        ("timestamp_s", 1_679_000_000_000),  # milliseconds
        ("timestamp_s", -1e150),
        ("travelled_m", 1e9),
        ("travelled_m", -1e9),
    ],
)
def test_no_time_in_seconds_and_no_distance_that_a_vehicle_drives_blocks_a_track(
    client, basis, track, name, odd
):
    observe(client, track, 0, timestamp_s=10.0)
    signed = signatures(basis, 1)
    scan = {"content": kitti(recording().scans[1]), "headers": KITTI}
    given = {"timestamp_s": 11.0, "travelled_m": 1.0} | {name: odd}
    refused = client.post(f"{track}/observations", params=given, **scan)
    assert problem_of(refused) == (422, "invalid-request")
    details = [refused.json()["detail"]]
    numbers = float(given["timestamp_s"]), float(given["travelled_m"])
    with open_stream(client, f"{track}/stream") as stream:
        stream.send_json({**as_json(signed), **given})
        stream.send_bytes(struct.pack("<BQdd", 64, 1, *numbers) + pack_signatures(signed))
        answers = [stream.receive_json() for _ in range(2)]
    assert [answer["status"] for answer in answers] == [422, 422]
    details += [answer["detail"] for answer in answers]
    assert all(name in detail for detail in details)
    if name == "timestamp_s":
        assert all("wanted seconds" in detail for detail in details)
    assert observe(client, track, 1, timestamp_s=12.0)["observations"] == 2


def test_the_farthest_times_are_observed_and_saved(client, track):
    for time_s in (-1e11, 0.0, 1e11):
        observe(client, track, 1, timestamp_s=time_s)
    client.service.tracks.save()
    assert {one["observations"] for one in client.get(TRACKS).json()["items"]} == {3}


def test_an_invalid_observation_is_refused_with_its_problem_and_changes_nothing(
    client, basis, track
):
    observe(client, track, 0)
    before = client.get(track).json()
    url = f"{track}/observations"
    stale = {**as_json(signatures(basis, 0)), "revision": "0" * 64}
    assert problem_of(client.post(url, json=stale)) == (409, "stale-signature")
    assert problem_of(client.post(url, json={"revision": "x"})) == (422, "invalid-request")
    assert problem_of(client.post(url, content=b"", headers=PACKED)) == (422, "empty-body")
    assert problem_of(client.post(url, content=b"abc", headers=PACKED))[1] == "invalid-signature"
    of_stream = struct.pack("<BQdd", 64, 1, 0.1, 1.0) + pack_signatures(signatures(basis, 1))
    refused = client.post(url, content=of_stream, headers=PACKED)
    assert problem_of(refused) == (422, "invalid-signature")
    assert "for the track's WebSocket, .../stream" in refused.json()["detail"]
    assert problem_of(client.post(url, content=b"abc", headers=IMAGE)) == (422, "invalid-image")
    assert (
        problem_of(client.post(url, content=b"abc", headers={"Content-Type": "text/x"}))[0] == 415
    )
    few = {"content": kitti(recording().scans[0])[: 16 * 20], "headers": KITTI}
    assert problem_of(client.post(url, **few)) == (422, "too-few-returns")
    for wrong in ({"timestamp_s": "nan"}, {"sequence": -1}, {"travelled_m": "inf"}):
        refused = client.post(url, params=wrong, content=b"x", headers=PACKED)
        assert problem_of(refused) == (422, "invalid-request")
    assert client.get(track).json() == before


def test_an_unknown_track_is_not_found(client, track):
    client.delete(track)
    for response in (client.get(track), client.delete(track), client.get(f"{TRACKS}/none")):
        assert problem_of(response) == (404, "track-not-found")
    assert problem_of(client.post("/v1/maps/none/tracks")) == (404, "map-not-found")
    assert problem_of(client.post(TRACKS, params={"revision": "f" * 64}))[1] == "revision-not-found"


def test_concurrent_observations_are_taken_one_at_a_time(client, track):
    threads = [threading.Thread(target=observe, args=(client, track, index)) for index in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert client.get(track).json()["last"]["observations"] == 6


# The stream


def test_a_stream_answers_each_packed_signature(client, basis, track):
    with open_stream(client, f"{track}/stream") as stream:
        for index in range(6):
            stream.send_bytes(pack_signatures(signatures(basis, index)))
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
    monkeypatch.setattr("app.tracking.live_track._QUICK_S", 60.0)
    with open_stream(client, f"{track}/stream") as stream:
        for index in range(8):
            if index == 4:  # what is kept of the catalog has to be read again, in a thread
                client.patch("/v1/maps/campus", json={"description": "changed"}).raise_for_status()
            stream.send_bytes(pack_signatures(signatures(basis, index)))
            assert stream.receive_json()["observations"] == index + 1
    assert len(begun) == 7  # all but the first
    assert 4 <= len(answered) < 7


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
    monkeypatch.setattr("app.tracking.live_track._QUICK_S", 60.0)
    with open_stream(client, f"{track}/stream") as stream:
        for index in range(2):
            stream.send_bytes(pack_signatures(signatures(basis, index)))
            assert stream.receive_json()["observations"] == index + 1
    assert still_held == [True]


def test_json_of_more_than_a_kibibyte_is_not_read_on_the_event_loop(
    client, basis, track, monkeypatch
):
    """64 KiB of it take 0.14 s, in which nobody else gets an answer."""
    run, begun = Pool.run_here, []

    async def noted(pool, key, work):
        begun.append(len(sent))
        return await run(pool, key, work)

    monkeypatch.setattr(Pool, "run_here", noted)
    monkeypatch.setattr("app.tracking.live_track._QUICK_S", 60.0)
    with open_stream(client, f"{track}/stream") as stream:
        stream.send_bytes(pack_signatures(signatures(basis, 0)))
        assert stream.receive_json()["observations"] == 1
        for sent in ("{" + " " * 1022 + "}", "{" + " " * 1023 + "}", "{" + " " * 60_000 + "}"):
            stream.send_text(sent)
            assert stream.receive_json()["type"] == "/problems/invalid-request"
    assert begun == [1024]


def test_a_stream_takes_json_and_continues_after_a_rejection(client, basis, track):
    with open_stream(client, f"{track}/stream") as stream:
        stream.send_json({**as_json(signatures(basis, 0)), "sequence": 3, "timestamp_s": 1.0})
        assert stream.receive_json()["observations"] == 1
        stream.send_json({**as_json(signatures(basis, 1)), "sequence": 3})
        assert stream.receive_json()["type"] == "/problems/stale-observation"
        for nonsense in ("{", '{"revision": 1}', "[]"):
            stream.send_text(nonsense)
            assert stream.receive_json()["type"] == "/problems/invalid-request"
        stream.send_bytes(b"")
        assert stream.receive_json()["type"] == "/problems/invalid-signature"
        stream.send_bytes(pack_signatures(signatures(basis, 1)))
        assert stream.receive_json()["observations"] == 2


def test_a_rejected_packed_message_has_its_number_and_time_whatever_is_wrong_with_it(
    client, basis, track
):
    packed = pack_signatures(signatures(basis, 0))
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
        stream.send_bytes(pack_signatures(signatures(basis, 0)))
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


# Limits and keys


def test_a_stream_without_the_key_is_refused_before_it_opens(tmp_path):
    with running(tmp_path / "data", admin_key=KEY) as client:
        for headers, name in (
            ({}, "key-needed"),
            ({"Authorization": f"Basic {KEY}"}, "key-needed"),
            ({"Authorization": f"Bearer {KEY}x"}, "key-refused"),
            ({"Authorization": f"Bearer {KEY}"}, "map-not-found"),
        ):
            with (
                pytest.raises(WebSocketDenialResponse) as refused,
                open_stream(client, f"{TRACKS}/none/stream", headers=headers),
            ):
                pass
            assert refused.value.json()["type"] == f"/problems/{name}"


def test_tracks_are_limited_removed_when_idle_and_pinned_to_their_revision(tmp_path):
    with running(tmp_path / "data", max_tracks=2, max_json_bytes=20_000) as client:
        fill(client, "harmonic")
        one, _ = (client.post(TRACKS).headers["Location"] for _ in range(2))
        assert problem_of(client.post(TRACKS)) == (503, "too-many-tracks")
        pinned = observe(client, one, 0)["revision"]
        again = {"segments": 4, "encoding": "harmonic", "make_live": True}
        job = client.post("/v1/maps/campus/builds", json=again).json()["job"]
        live = wait_for(client, job)["revision"]
        answer = observe(client, one, 1)
        assert (answer["revision"], answer["live_revision"]) == (pinned, live)
        assert pinned != live
        with open_stream(client, f"{one}/stream") as stream:
            stream.send_bytes(bytes(20_001))
            assert stream.receive_json()["type"] == "/problems/body-too-large"
            with pytest.raises(WebSocketDisconnect) as closed:
                stream.receive_json()
        assert closed.value.code == 1009
        tracks = client.service.tracks
        tracks._clock = tracks._monotonic = lambda: 1e12
        assert problem_of(client.get(one)) == (404, "track-not-found")
        assert client.post(TRACKS).json()["revision"] == live
        assert len(tracks) == 1


def test_a_stream_that_is_requested_over_http_is_426_and_names_the_websocket(client):
    # As through a proxy that drops `Upgrade`, whatever the track.
    for track in ("none", client.post(TRACKS).json()["track"]):
        refused = client.get(f"{TRACKS}/{track}/stream")
        assert problem_of(refused) == (426, "upgrade-required")
        assert "WebSocket" in refused.json()["detail"]
        assert refused.headers["Upgrade"] == "websocket"
    posted = client.post(f"{TRACKS}/none/stream")
    assert problem_of(posted) == (405, "method-not-allowed")
    assert posted.headers["Allow"] == "GET, HEAD"


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
