"""Tracks in lists, and tracks that outlast the process of the service."""

import time
from datetime import datetime

import pytest
from starlette.testclient import WebSocketDenialResponse

from app.tracking.live_track import LiveTrack
from app.tracking.tracks import Tracks
from core.encodings.signature import pack_signatures, unpack_signatures
from core.tracking.track import Observation
from tests.support.access import ADMIN, ADMIN_KEY, LOCALIZE, READ, bearer, holder, make
from tests.support.campus import MAP, PACKED, basis_of, build
from tests.support.recording import recording
from tests.support.service import copy_of, problem_of, running

TRACKS = f"{MAP}/tracks"
FAR = 1e12


@pytest.fixture(scope="module")
def harmonic(tmp_path_factory, campus_of):
    """A stopped service's data, with a harmonic map, and what its vehicles send."""
    built = campus_of(segments=3, encoding="harmonic", views="full")
    data_dir = copy_of(built, tmp_path_factory.mktemp("harmonic") / "data")
    with running(data_dir) as client:
        basis = basis_of(client)
    scans = recording(noise_seed=7).scans
    return data_dir, [pack_signatures(basis.encode(basis.image(scan))) for scan in scans]


@pytest.fixture
def service(harmonic, tmp_path):
    """Starts a service on one copy of the data, each time it is called."""
    data_dir = copy_of(harmonic[0], tmp_path / "data")
    return lambda **settings: running(data_dir, **settings)


@pytest.fixture
def drive(harmonic):
    """Sends observations of a range of scans and returns the answers."""

    def send(client, track, scans, headers=PACKED, **params):
        url = f"{TRACKS}/{track}/observations"
        answers = [
            client.post(url, content=harmonic[1][scan], headers=headers, params=params)
            for scan in scans
        ]
        assert {answer.status_code for answer in answers} <= {200}, answers[-1].text
        return [answer.json() for answer in answers]

    return send


def new_track(client, headers=None):
    created = client.post(TRACKS, headers=headers)
    assert created.status_code == 201, created.text
    return created.json()["track"]


def listed(client, headers=None, **params):
    page = client.get(TRACKS, headers=headers, params=params)
    assert page.status_code == 200, page.text
    return page.json()


# Lists


def test_tracks_are_listed_with_their_last_place(service, drive):
    with service() as client:
        assert listed(client) == {"items": [], "next_after": None}
        made = {new_track(client) for _ in range(3)}
        track = min(made)
        last = drive(client, track, range(12))[-1]
        items = {item["track"]: item for item in listed(client)["items"]}
        assert items.keys() == made
        shown = items[track]
        assert shown["place"] == {name: last[name] for name in shown["place"]}
        assert shown["place"]["localized"]
        assert (shown["key"], shown["observations"]) == ("everyone", 12)
        assert shown["revision"] == last["revision"]
        at = [datetime.fromisoformat(shown[name]) for name in ("created_at", "last_observation_at")]
        assert at == sorted(at)
        fresh = items[max(made)]
        assert (fresh["observations"], fresh["place"], fresh["last_observation_at"]) == (
            0,
            None,
            None,
        )


def test_lists_have_pages_and_their_cursor_outlives_its_track(service):
    with service() as client:
        made = sorted(new_track(client) for _ in range(5))
        page = listed(client, limit=2)
        assert [item["track"] for item in page["items"]] == made[:2]
        client.delete(f"{TRACKS}/{made[1]}")
        rest = listed(client, limit=3, after=page["next_after"])
        assert [item["track"] for item in rest["items"]] == made[2:]
        assert rest["next_after"] is None
        assert problem_of(client.get(TRACKS, params={"limit": 0})) == (422, "invalid-request")
        assert problem_of(client.get("/v1/maps/none/tracks")) == (404, "map-not-found")


def test_a_key_lists_its_own_tracks_and_an_administrator_all(service):
    with service(admin_key=ADMIN_KEY) as client:
        one, two = (make(client, LOCALIZE) for _ in range(2))
        mine = new_track(client, bearer(one["secret"]))
        other = new_track(client, bearer(two["secret"]))
        [item] = listed(client, bearer(one["secret"]))["items"]
        assert (item["track"], item["key"]) == (mine, one["key"])
        assert {item["track"] for item in listed(client, ADMIN)["items"]} == {mine, other}
        assert problem_of(client.get(TRACKS, headers=holder(client, READ)))[0] == 403
        elsewhere = holder(client, LOCALIZE, maps=["depot"])
        assert problem_of(client.get(TRACKS, headers=elsewhere)) == (404, "map-not-found")


def test_a_track_is_not_found_in_another_map_though_its_name_is_known(service, harmonic):
    with service(admin_key=ADMIN_KEY) as client:
        client.post("/v1/maps", json={"map": "depot"}, headers=ADMIN)
        track = new_track(client, holder(client, LOCALIZE, maps=["campus"]))
        elsewhere = holder(client, LOCALIZE, maps=["depot"])
    url = f"/v1/maps/depot/tracks/{track}"
    with service(admin_key=ADMIN_KEY) as client:
        for _ in ("as it was saved", "as it goes on"):
            observation = {"content": harmonic[1][0], "headers": {**elsewhere, **PACKED}}
            for refused in (
                client.get(url, headers=elsewhere),
                client.delete(url, headers=elsewhere),
                client.post(f"{url}/observations", **observation),
            ):
                assert problem_of(refused) == (404, "track-not-found")
            with (
                pytest.raises(WebSocketDenialResponse) as denied,
                client.websocket_connect(f"ws://127.0.0.1{url}/stream", headers=elsewhere),
            ):
                pass
            assert denied.value.status_code == 404
            observation["headers"] = {**ADMIN, **PACKED}
            went_on = client.post(f"{TRACKS}/{track}/observations", **observation)
            assert went_on.status_code == 200


def test_an_idle_track_is_not_listed(service):
    with service() as client:
        new_track(client)
        client.service.tracks._clock = lambda: FAR
        assert listed(client)["items"] == []


def test_a_track_that_cannot_be_saved_does_not_stop_the_others(service, drive, monkeypatch, caplog):
    def failing(track, answer):
        if track.id == broken:
            raise ValueError("no number")
        return to_save(track, answer)

    with service() as client:
        broken, whole = new_track(client), new_track(client)
        for track in (broken, whole):
            drive(client, track, [3])
        to_save = LiveTrack.to_save
        monkeypatch.setattr(LiveTrack, "to_save", failing)
        client.service.tracks.save()
        saved = client.service.tracks._saved
        assert (saved.get(broken).observations, saved.get(whole).observations) == (0, 1)
        assert f"track {broken} cannot be saved" in caplog.text
        observed = {one["track"]: one["observations"] for one in listed(client)["items"]}
        assert observed == {broken: 0, whole: 1}


# Restarts


def test_a_track_goes_on_after_a_restart(service, drive):
    with service() as client:
        track = new_track(client)
        drive(client, track, range(12))
        before, of_list = client.get(f"{TRACKS}/{track}").json(), listed(client)
    with service() as client:
        assert listed(client) == of_list
        assert client.get(f"{TRACKS}/{track}").json() == before
        answers = drive(client, track, range(14, 24))
        assert [answer["observations"] for answer in answers] == list(range(13, 23))
        assert answers[0]["reason"] == "converging"
        assert answers[-1]["localized"]
        for scan, answer in zip(range(14, 24), answers, strict=True):
            assert not answer["localized"] or abs(answer["scan_index"] - scan) <= 1
        with client.websocket_connect(f"ws://127.0.0.1{TRACKS}/{track}/stream") as stream:
            stream.send_bytes(b"")
            assert stream.receive_json()["type"] == "/problems/invalid-signature"


def test_a_stale_observation_is_still_rejected_after_a_restart(service, drive, harmonic):
    with service() as client:
        track = new_track(client)
        drive(client, track, [3], sequence=9, timestamp_s=4.0)
    with service() as client:
        for stale in ({"sequence": 9}, {"timestamp_s": 4.0}):
            url = f"{TRACKS}/{track}/observations"
            refused = client.post(url, content=harmonic[1][4], headers=PACKED, params=stale)
            assert problem_of(refused) == (409, "stale-observation")


def test_a_killed_service_loses_no_more_than_was_observed_since_it_saved(service, drive):
    with service() as client:
        track = new_track(client)
        drive(client, track, range(8))
        client.service.tracks.save()
        drive(client, track, range(8, 12))
        client.service.tracks.save = lambda: None  # as if it were killed now
    with service() as client:
        assert listed(client)["items"][0]["observations"] == 8
        answers = drive(client, track, range(20, 30))
        assert answers[-1]["localized"]
        for scan, answer in zip(range(20, 30), answers, strict=True):
            assert not answer["localized"] or abs(answer["scan_index"] - scan) <= 1


def test_a_track_that_was_created_or_deleted_is_so_after_a_kill(service):
    with service() as client:
        client.service.tracks.save = lambda: None
        kept, deleted = new_track(client), new_track(client)
        client.delete(f"{TRACKS}/{deleted}")
    with service() as client:
        assert client.get(f"{TRACKS}/{kept}").json()["last"] is None
        assert problem_of(client.get(f"{TRACKS}/{deleted}")) == (404, "track-not-found")


def test_tracks_of_before_a_restart_count_and_expire_as_others(service):
    with service(admin_key=ADMIN_KEY, max_tracks=3, max_tracks_per_key=2) as client:
        greedy, other = holder(client, LOCALIZE), holder(client, LOCALIZE)
        new_track(client, greedy)
        new_track(client, greedy)
    with service(admin_key=ADMIN_KEY, max_tracks=3, max_tracks_per_key=2) as client:
        refused = client.post(TRACKS, headers=greedy)
        assert problem_of(refused) == (429, "too-many-tracks-of-key")
        new_track(client, other)
        assert problem_of(client.post(TRACKS, headers=other)) == (503, "too-many-tracks")
    with service(admin_key=ADMIN_KEY, track_idle_s=0.01) as client:
        time.sleep(0.01)
        assert len(client.service.tracks) == 0
        assert listed(client, ADMIN)["items"] == []


def test_a_track_does_not_become_idle_while_it_observes_or_is_looked_at(service, drive):
    passed_s = 0.0
    with service(track_idle_s=60.0) as client:
        tracks = client.service.tracks
        clock, monotonic = tracks._clock, tracks._monotonic
        tracks._clock, tracks._monotonic = (
            lambda: clock() + passed_s,
            lambda: monotonic() + passed_s,
        )
        track = new_track(client)
        for scan in range(3):
            passed_s += 40.0
            drive(client, track, [scan])
        for _ in range(3):
            passed_s += 40.0
            assert client.get(f"{TRACKS}/{track}").json()["last"]["observations"] == 3
        passed_s += 61.0
        assert problem_of(client.get(f"{TRACKS}/{track}")) == (404, "track-not-found")


def test_an_idle_track_is_not_found_after_a_restart(service):
    with service() as client:
        track = new_track(client)
    with service() as client:
        client.service.tracks._clock = lambda: FAR
        assert problem_of(client.get(f"{TRACKS}/{track}")) == (404, "track-not-found")


def test_a_revoked_key_does_not_get_its_track_back(service):
    with service(admin_key=ADMIN_KEY) as client:
        made = make(client, LOCALIZE)
        headers = bearer(made["secret"])
        track = new_track(client, headers)
    with service(admin_key=ADMIN_KEY) as client:
        client.delete(f"/v1/keys/{made['key']}", headers=ADMIN)
        url = f"{TRACKS}/{track}"
        assert problem_of(client.get(url, headers=headers)) == (401, "key-refused")
        assert problem_of(client.get(TRACKS, headers=headers)) == (401, "key-refused")


def test_a_track_of_a_revision_that_is_gone_ends_with_its_name(service, drive, harmonic):
    with service() as client:
        track = new_track(client)
        revision = drive(client, track, [3])[0]["revision"]
        build(client, segments=2, encoding="harmonic", views="full", make_live=True)
        assert client.delete(f"{MAP}/revisions/{revision}").status_code == 204
        drive(client, track, [4])  # it is in memory
    with service() as client:
        url = f"{TRACKS}/{track}"
        assert problem_of(client.get(url)) == (404, "revision-not-found")
        refused = client.post(f"{url}/observations", content=harmonic[1][5], headers=PACKED)
        assert problem_of(refused) == (404, "revision-not-found")
        with (
            pytest.raises(WebSocketDenialResponse) as ended,
            client.websocket_connect(f"ws://127.0.0.1{url}/stream"),
        ):
            pass
        assert ended.value.json()["type"] == "/problems/revision-not-found"
        assert client.delete(url).status_code == 204


def test_a_state_that_cannot_be_read_is_no_track(service, drive):
    with service() as client:
        track = new_track(client)
        drive(client, track, [3])
        saved = client.service.tracks._saved
        client.service.tracks.save()
        found = saved.get(track)
        found.state["places"] = "nowhere"
        saved.update([(1, found)])
        client.service.tracks.save = lambda: None
    with service() as client:
        assert problem_of(client.get(f"{TRACKS}/{track}")) == (404, "track-not-found")


def test_an_answer_of_another_version_is_not_shown(service, drive):
    with service() as client:
        track = new_track(client)
        drive(client, track, range(4))
        client.service.tracks.save()
        saved = client.service.tracks._saved
        found = saved.get(track)
        del found.last["drive"], found.last["scan_index"]
        saved.update([(4, found)])
        client.service.tracks.save = lambda: None
    with service() as client:
        [item] = listed(client)["items"]
        assert (item["observations"], item["place"]) == (4, None)
        assert client.get(f"{TRACKS}/{track}").json()["last"] is None
        assert drive(client, track, [4])[0]["observations"] == 5
        assert client.get(f"{TRACKS}/{track}").json()["last"]["observations"] == 5


def test_two_processes_on_one_database_share_their_tracks(service, drive, harmonic):
    """As replicas will: each goes on with what the other one saved."""
    with service() as client:
        running = client.service
        own, other = running.tracks, Tracks(9, 600.0, 9, 9, saved=running.store.saved_tracks())
        track = new_track(client)
        drive(client, track, range(6))
        own.save()
        localizer = running.revisions.live("campus").localizer
        theirs = other.get(running.store.maps.get("campus").id, track, lambda _: localizer)
        for scan in range(6, 9):
            theirs.observe(Observation(unpack_signatures(harmonic[1][scan])))
        other.save()
        assert drive(client, track, [6])[0]["observations"] == 7
        own.save()  # it finds that the other one went on with it
        assert drive(client, track, [9])[0]["observations"] == 10
        other.close()
