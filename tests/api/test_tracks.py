"""Tracks over HTTP: a vehicle's observations, one after another."""

import struct
import threading

import numpy as np
import pytest
from starlette.websockets import WebSocketDisconnect

from core.encodings.signature import pack_signatures
from tests.support.campus import IMAGE, PACKED, build
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import copy_of, problem_of, running
from tests.support.tracks import TRACKS, as_json, open_stream, signed


@pytest.fixture(scope="module", params=["paper", "harmonic"])
def client(tmp_path_factory, campus_of, request):
    built = campus_of(segments=3, encoding=request.param)
    data_dir = copy_of(built, tmp_path_factory.mktemp("tracks") / "data")
    with running(data_dir, max_tracks=40) as client:
        yield client


def observe(client, track, index, **params):
    scan = recording(noise_seed=7).scans[index]
    answer = client.post(f"{track}/observations", content=kitti(scan), headers=KITTI, params=params)
    assert answer.status_code == 200, answer.text
    return answer.json()


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
        "json": lambda i: {"json": as_json(signed(basis, i))},
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
        # In a map with verification images the pose of a scan is of more than its signature, and
        # the position on the path follows it.
        assert differ <= {"pose", "fraction", "heading_deg", "lateral_m", "turn_deg"}, differ
        # A scan is 0.06 of its segment.
        assert one["fraction"] == pytest.approx(two["fraction"], abs=0.01)


@pytest.mark.parametrize(
    "option", ["sensor_height_m=2", "mounting=1,0,1.7", "roll_deg=3", "pitch_deg=3", "format=kitti"]
)
def test_signatures_and_images_take_no_options_of_a_scan(client, basis, track, option):
    signature = pack_signatures(signed(basis, 1))
    image = basis.image(recording().scans[1]).cells.astype("<f4").tobytes()
    for body, head in ((signature, PACKED), (image, IMAGE)):
        refused = client.post(f"{track}/observations?{option}", content=body, headers=head)
        assert problem_of(refused) == (422, "invalid-parameters")
        assert option.split("=")[0] in refused.json()["detail"]
        assert client.get(track).json()["last"] is None


def test_a_packed_signature_is_an_observation_too(client, basis, track):
    for index in range(6):
        body = pack_signatures(signed(basis, index))
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
    signatures = signed(basis, 1)
    scan = {"content": kitti(recording().scans[1]), "headers": KITTI}
    given = {"timestamp_s": 11.0, "travelled_m": 1.0} | {name: odd}
    refused = client.post(f"{track}/observations", params=given, **scan)
    assert problem_of(refused) == (422, "invalid-request")
    details = [refused.json()["detail"]]
    numbers = float(given["timestamp_s"]), float(given["travelled_m"])
    with open_stream(client, f"{track}/stream") as stream:
        stream.send_json({**as_json(signatures), **given})
        stream.send_bytes(struct.pack("<BQdd", 64, 1, *numbers) + pack_signatures(signatures))
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
    stale = {**as_json(signed(basis, 0)), "revision": "0" * 64}
    assert problem_of(client.post(url, json=stale)) == (409, "stale-signature")
    assert problem_of(client.post(url, json={"revision": "x"})) == (422, "invalid-request")
    assert problem_of(client.post(url, content=b"", headers=PACKED)) == (422, "empty-body")
    assert problem_of(client.post(url, content=b"abc", headers=PACKED))[1] == "invalid-signature"
    of_stream = struct.pack("<BQdd", 64, 1, 0.1, 1.0) + pack_signatures(signed(basis, 1))
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


def test_tracks_are_limited_removed_when_idle_and_pinned_to_their_revision(tmp_path, campus_of):
    data_dir = copy_of(campus_of(segments=3, encoding="harmonic"), tmp_path / "data")
    with running(data_dir, max_tracks=2, max_json_bytes=20_000) as client:
        one, _ = (client.post(TRACKS).headers["Location"] for _ in range(2))
        assert problem_of(client.post(TRACKS)) == (503, "too-many-tracks")
        pinned = observe(client, one, 0)["revision"]
        live = build(client, segments=4, encoding="harmonic", make_live=True)["revision"]
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
