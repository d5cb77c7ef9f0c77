"""While one map is loaded, the vehicles of all others are answered."""

import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import pytest

import app.tracking.routes
import app.tracking.tracks
import storage.store.revisions
from app.revisions.schemas import BasisOut
from app.tracking.live_track import LiveTrack
from core.encodings.signature import pack_signatures
from tests.support.campus import PACKED
from tests.support.recording import recording
from tests.support.service import copy_of, damage, problem_of, running, upload, wait_for

LARGE, SMALL = "/v1/maps/large", "/v1/maps/small"


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """Data of a stopped service with two maps, a track in each, and an observation for each."""
    data_dir = tmp_path_factory.mktemp("two") / "data"
    sent, tracks = {}, {}
    with running(data_dir) as client:
        for url, segments in ((LARGE, 2), (SMALL, 3)):
            slug = url.rpartition("/")[2]
            client.post("/v1/maps", json={"map": slug})
            upload(client, "monday", recording(), slug=slug)
            parameters = {"segments": segments, "encoding": "harmonic", "views": "full"}
            queued = client.post(f"{url}/builds", json=parameters)
            assert wait_for(client, queued.json()["job"])["state"] == "done"
            basis = BasisOut.model_validate(client.get(f"{url}/basis").json()).to_core()
            scan = recording(noise_seed=7).scans[5]
            sent[url] = pack_signatures(basis.encode(basis.image(scan)))
            tracks[url] = client.post(f"{url}/tracks").headers["Location"]
            assert observe(client, tracks[url], sent[url]) == 200
    return data_dir, tracks, sent


def create(client, url):
    return client.post(f"{url}/tracks")


def observe(client, track, sent):
    return client.post(f"{track}/observations", content=sent, headers=PACKED).status_code


def stream(client, track, sent):
    """Open the stream of a track, and return the answer to one observation."""
    with client.websocket_connect(f"ws://127.0.0.1{track}/stream") as opened:
        opened.send_bytes(sent)
        return opened.receive_json()


@pytest.fixture(params=["read", "prepared"])
def blocked(monkeypatch, stopped, request):
    """Block the large map while it is read or prepared; the events are that start and its end."""
    begun, go_on = threading.Event(), threading.Event()
    module, name = {
        "read": (storage.store.revisions, "read_revision"),
        "prepared": (app.tracking.tracks, "Tracker"),
    }[request.param]
    real = getattr(module, name)

    def slow(*given):
        made = real(*given)
        tensor_map = made if request.param == "read" else made.map
        if len(tensor_map.model.segment_start) == 3:  # of the large one's two segments
            begun.set()
            assert go_on.wait(30)
        return made

    monkeypatch.setattr(module, name, slow)
    return begun, go_on


def test_while_one_map_is_loaded_tracks_of_another_open_and_answer(stopped, blocked, tmp_path):
    data_dir, tracks, sent = stopped
    begun, go_on = blocked
    with (
        running(copy_of(data_dir, tmp_path / "data"), short_threads=2) as client,
        ThreadPoolExecutor(16) as vehicles,
        ExitStack() as ending,
    ):
        ending.callback(go_on.set)
        waiting = [
            vehicles.submit(work, *given)
            for _ in range(4)
            for work, *given in (
                (create, client, LARGE),
                (observe, client, tracks[LARGE], sent[LARGE]),
                (stream, client, tracks[LARGE], sent[LARGE]),
            )
        ]
        assert begun.wait(30)
        created = vehicles.submit(create, client, SMALL).result(20)
        assert created.status_code == 201, created.text
        for track in (created.headers["Location"], tracks[SMALL]):
            answer = vehicles.submit(stream, client, track, sent[SMALL]).result(20)
            assert answer["track"] == track.rpartition("/")[2]
            assert vehicles.submit(observe, client, track, sent[SMALL]).result(20) == 200
        assert not any(one.done() for one in waiting)
        go_on.set()
        late = [one.result() for one in waiting]
    assert {answer.status_code for answer in late[0::3]} == {201}
    assert late[1::3] == [200] * 4
    assert {answer["track"] for answer in late[2::3]} == {tracks[LARGE].rpartition("/")[2]}


def test_a_map_whose_file_was_damaged_is_answered_again_once_it_is_repaired(stopped, tmp_path):
    data_dir, _, sent = stopped
    copied = copy_of(data_dir, tmp_path / "data")
    with running(copied) as client:
        digest = client.get(f"{SMALL}").json()["live_revision"]
        [file] = [path for path in copied.rglob("*.h5") if digest[:12] in str(path)]
        content = file.read_bytes()
        damage(file, content[:1000])
        for _ in range(2):
            assert problem_of(client.post(f"{SMALL}/tracks")) == (500, "corrupt-file")
        damage(file, content)
        created = client.post(f"{SMALL}/tracks")
        assert created.status_code == 201, created.text
        assert observe(client, created.headers["Location"], sent[SMALL]) == 200


def test_tracks_of_more_maps_than_are_kept_in_memory_go_on(stopped, tmp_path):
    data_dir, tracks, sent = stopped
    with running(copy_of(data_dir, tmp_path / "data"), tracked_revisions=1) as client:
        for count in (2, 3, 4):
            for url in (LARGE, SMALL):
                answer = stream(client, tracks[url], sent[url])
                assert answer["observations"] == count
                kept = client.service.tracks._tracks.values()
                assert [track.id for track in kept if isinstance(track, LiveTrack)] == [
                    answer["track"]
                ]
        listed = [client.get(f"{url}/tracks").json()["items"] for url in (LARGE, SMALL)]
        assert [len(items) for items in listed] == [1, 1]


def test_an_observation_of_a_track_that_is_unloaded_meanwhile_is_taken_all_the_same(
    stopped, tmp_path, monkeypatch
):
    data_dir, tracks, sent = stopped
    with running(copy_of(data_dir, tmp_path / "data"), tracked_revisions=1) as client:
        found = app.tracking.routes.track_of
        between = [lambda: create(client, SMALL)]

        def found_before_it_is_unloaded(*given):
            track = found(*given)
            if between:
                assert between.pop()().status_code == 201
            return track

        monkeypatch.setattr(app.tracking.routes, "track_of", found_before_it_is_unloaded)
        answer = client.post(f"{tracks[LARGE]}/observations", content=sent[LARGE], headers=PACKED)
        assert answer.json()["observations"] == 2
        assert not between
