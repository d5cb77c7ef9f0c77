"""Shares of keys: one key leaves tracks, streams and queued builds to others."""

import time
from contextlib import ExitStack

import pytest
from starlette.testclient import WebSocketDenialResponse
from starlette.websockets import WebSocketDisconnect

import app.jobs.events
from tests.support.access import ADMIN, ADMIN_KEY, LOCALIZE, READ, WRITE, holder, make
from tests.support.service import copy_of, problem_of, running, wait_for
from tests.support.workers import never_end

TRACKS = "/v1/maps/campus/tracks"
BUILDS = "/v1/maps/campus/builds"
DRIVE = "/v1/maps/campus/drives/monday"


@pytest.fixture
def sparing(tmp_path, built):
    """A service that gives each key little."""
    with running(
        copy_of(built.data_dir, tmp_path / "data"),
        admin_key=ADMIN_KEY,
        max_tracks=4,
        max_tracks_per_key=3,
        max_streams=3,
        max_streams_per_key=2,
        max_queued_builds_per_key=2,
    ) as client:
        yield client


def stream_of(client, track, headers):
    return client.websocket_connect(f"ws://127.0.0.1{track}/stream", headers=headers)


def refused_stream(client, track, headers):
    with pytest.raises(WebSocketDenialResponse) as refused, stream_of(client, track, headers):
        pass
    return refused.value.status_code, refused.value.json()["type"].removeprefix("/problems/")


def begin_track(client, headers):
    begun = client.post(TRACKS, headers=headers)
    assert begun.status_code == 201, begun.text
    return begun.headers["Location"]


def test_a_key_that_keeps_all_the_tracks_it_may_leaves_some_to_others(sparing):
    greedy, other = holder(sparing, LOCALIZE), holder(sparing, LOCALIZE)
    begun = [begin_track(sparing, greedy) for _ in range(3)]
    refused = sparing.post(TRACKS, headers=greedy)
    assert problem_of(refused) == (429, "too-many-tracks-of-key")
    mine = [begin_track(sparing, other) for _ in range(2)]  # 3 + 1, then one of the greedy key's
    assert problem_of(sparing.post(TRACKS, headers=other)) == (503, "too-many-tracks")
    assert problem_of(sparing.get(begun[0], headers=greedy)) == (404, "track-not-found")
    for track in (*begun[1:], *mine):
        assert sparing.get(track, headers=ADMIN).status_code == 200


def test_streams_are_bounded_for_a_key_and_for_all(sparing):
    one, two = holder(sparing, LOCALIZE), holder(sparing, LOCALIZE)
    track = begin_track(sparing, one)
    with ExitStack() as opened:
        for _ in range(2):
            opened.enter_context(stream_of(sparing, track, one))
        assert refused_stream(sparing, track, one) == (429, "too-many-streams-of-key")
        opened.enter_context(stream_of(sparing, track, two))
        assert refused_stream(sparing, track, two) == (503, "too-many-streams")
        assert len(sparing.service.streams) == 3
    with stream_of(sparing, track, one), stream_of(sparing, track, one):
        pass  # what was closed is open to others again


def test_a_key_whose_streams_are_all_open_is_refused_without_a_look_at_the_catalog(
    sparing, monkeypatch
):
    one, two = holder(sparing, LOCALIZE), holder(sparing, LOCALIZE)
    track = begin_track(sparing, one)
    looked_up: list[str] = []
    known = sparing.service.store.keys.with_hash

    def counted(secret_hash):
        looked_up.append(secret_hash)
        return known(secret_hash)

    with ExitStack() as opened:
        for _ in range(2):
            opened.enter_context(stream_of(sparing, track, one))
        monkeypatch.setattr(sparing.service.store.keys, "with_hash", counted)
        assert refused_stream(sparing, track, one) == (429, "too-many-streams-of-key")
        assert not looked_up
        opened.enter_context(stream_of(sparing, track, two))
        assert looked_up


def test_a_large_message_of_a_stream_is_heavy_work(sparing, monkeypatch):
    one = holder(sparing, LOCALIZE)
    track = begin_track(sparing, one)
    pools = sparing.service.pools
    ran = []
    for pool in (pools.matching, pools.heavy):

        async def run(key, work, pool=pool, in_pool=pool.run):
            ran.append(pool)
            return await in_pool(key, work)

        monkeypatch.setattr(pool, "run", run)
    with stream_of(sparing, track, one) as stream:
        for spaces in (2**11, 2**17):
            stream.send_text("{" + " " * spaces + "}")
            assert stream.receive_json()["type"] == "/problems/invalid-request"
    assert ran == [pools.matching, pools.heavy]


@pytest.mark.parametrize(
    ("method", "path", "is_long"),
    [
        ("PATCH", DRIVE, True),  # its files are packed
        ("DELETE", DRIVE, False),
        ("DELETE", f"{DRIVE}?purge=false", False),
        ("DELETE", f"{DRIVE}?purge=true", True),
        ("DELETE", "/v1/maps/campus", False),
        ("DELETE", "/v1/maps/campus?purge=true", True),
        ("DELETE", "/v1/recycle-bin/{entry}", True),
    ],
)
def test_what_packs_or_removes_files_is_heavy_work_and_a_deletion_is_not(
    sparing, monkeypatch, method, path, is_long
):
    if "{entry}" in path:
        sparing.delete(DRIVE, headers=ADMIN)
        entry = sparing.get("/v1/recycle-bin", headers=ADMIN).json()["items"][0]["entry"]
        path = path.format(entry=entry)
    pool, ran = sparing.service.pools.heavy, []
    run = pool.run

    async def run_and_note(*args, **options):
        ran.append(path)
        return await run(*args, **options)

    monkeypatch.setattr(pool, "run", run_and_note)
    body = {"json": {"closed": True}} if method == "PATCH" else {}
    assert sparing.request(method, path, headers=ADMIN, **body).status_code < 300
    assert bool(ran) == is_long


def test_the_check_of_a_file_before_its_download_is_heavy_work(own, built, monkeypatch):
    pool, ran = own.service.pools.heavy, []
    run = pool.run

    async def run_and_note(*args, **options):
        ran.append(options)
        return await run(*args, **options)

    monkeypatch.setattr(pool, "run", run_and_note)
    path = f"/v1/maps/campus/revisions/{built.live}"
    assert own.get(path).status_code == 200
    assert not ran
    for headers in ({}, {"Range": "bytes=0-9"}):
        assert own.get(f"{path}/file", headers=headers).is_success
    assert len(ran) == 2


def test_a_refused_stream_takes_nothing(sparing):
    one = holder(sparing, LOCALIZE)
    for _ in range(5):
        assert refused_stream(sparing, f"{TRACKS}/none", one) == (404, "track-not-found")
    assert len(sparing.service.streams) == 0


def test_a_stream_without_a_message_is_closed(tmp_path, built):
    data_dir = copy_of(built.data_dir, tmp_path / "data")
    with running(data_dir, stream_idle_s=0.2) as client:
        track = begin_track(client, {})
        with stream_of(client, track, {}) as stream, pytest.raises(WebSocketDisconnect) as closed:
            stream.receive_text()
        assert (closed.value.code, closed.value.reason) == (1001, "no message for 0.2 s")
        assert len(client.service.streams) == 0


def test_events_of_jobs_are_streams_too(sparing, monkeypatch):
    monkeypatch.setattr("app.jobs.runner.run_job", never_end)
    writer = holder(sparing, READ, WRITE)
    job = sparing.post(BUILDS, json={"segments": 2}, headers=writer).json()["job"]
    wait_for(AsHolder(sparing, writer), job, {"running"})
    events = f"/v1/jobs/{job}/events"
    with sparing.stream("GET", events, headers=writer) as first:
        assert first.status_code == 200
        with sparing.stream("GET", events, headers=writer):
            refused = sparing.get(events, headers=writer)
            assert problem_of(refused) == (429, "too-many-streams-of-key")
            assert sparing.delete(f"/v1/jobs/{job}", headers=writer).status_code == 200
    assert wait_for(AsHolder(sparing, writer), job)["state"] == "cancelled"
    assert sparing.get(events, headers=writer).status_code == 200


class AsHolder:
    """A client that sends one key."""

    def __init__(self, client, headers):
        self._client, self._headers = client, headers

    def get(self, path):
        return self._client.get(path, headers=self._headers)


def test_a_revoked_key_gets_no_more_events_and_others_do(sparing, monkeypatch):
    monkeypatch.setattr("app.jobs.runner.run_job", never_end)
    job = sparing.post(BUILDS, json={"segments": 2}, headers=ADMIN).json()["job"]
    revoked = make(sparing, READ)
    with sparing.stream(
        "GET",
        f"/v1/jobs/{job}/events",
        headers={"Authorization": f"Bearer {revoked['secret']}"},
    ) as answer:
        lines = answer.iter_lines()
        assert any(line.startswith("data: ") for line in lines)
        assert sparing.delete(f"/v1/keys/{revoked['key']}", headers=ADMIN).status_code == 200
        assert not [line for line in lines if '"done"' in line]  # the stream ends by itself


def test_many_clients_of_the_events_of_a_job_read_it_as_often_as_one(sparing, monkeypatch):
    monkeypatch.setattr("app.jobs.runner.run_job", never_end)
    monkeypatch.setattr(app.jobs.events, "_READ_EVERY_S", 0.02)
    job = sparing.post(BUILDS, json={"segments": 2}, headers=ADMIN).json()["job"]
    wait_for(AsHolder(sparing, ADMIN), job, {"running"})
    service = sparing.service
    reads, admitted = [], []
    with_ids, caller_of = service.store.jobs.with_ids, service.access.caller_of

    def counted_read(ids):
        reads.append(tuple(ids))
        return with_ids(ids)

    def counted_admission(connection):
        admitted.append(connection)
        return caller_of(connection)

    monkeypatch.setattr(service.store.jobs, "with_ids", counted_read)
    monkeypatch.setattr(service.access, "caller_of", counted_admission)
    with ExitStack() as opened:
        for _ in range(2):
            opened.enter_context(sparing.stream("GET", f"/v1/jobs/{job}/events", headers=ADMIN))
        admitted.clear()
        reads.clear()
        while len(reads) < 5:
            time.sleep(0.01)
        assert set(reads) == {(job,)}
        assert len(admitted) <= len(reads) + 1
        sparing.delete(f"/v1/jobs/{job}", headers=ADMIN)


def test_a_key_that_fills_the_queue_delays_no_other(sparing, monkeypatch):
    monkeypatch.setattr("app.jobs.runner.run_job", never_end)
    greedy, other = holder(sparing, WRITE), holder(sparing, WRITE)
    first = sparing.post(BUILDS, json={"segments": 2}, headers=greedy).json()["job"]
    wait_for(AsHolder(sparing, greedy), first, {"running"})
    for _ in range(2):
        queued = sparing.post(BUILDS, json={"segments": 2}, headers=greedy)
        assert queued.status_code == 202
    refused = sparing.post(BUILDS, json={"segments": 2}, headers=greedy)
    assert problem_of(refused) == (429, "too-many-builds")
    last = sparing.post(BUILDS, json={"segments": 2}, headers=other).json()["job"]
    sparing.delete(f"/v1/jobs/{first}", headers=greedy)
    assert wait_for(AsHolder(sparing, other), last, {"running"})["state"] == "running"


def test_two_keys_may_give_their_requests_one_name(sparing, monkeypatch):
    monkeypatch.setattr("app.jobs.runner.run_job", never_end)
    one, other = holder(sparing, WRITE), holder(sparing, WRITE)
    named = {"Idempotency-Key": "nightly"}
    first = sparing.post(BUILDS, json={"segments": 2}, headers=one | named).json()["job"]
    second = sparing.post(BUILDS, json={"segments": 1}, headers=other | named)
    assert (second.status_code, second.json()["job"] != first) == (202, True)
    again = sparing.post(BUILDS, json={"segments": 2}, headers=one | named)
    assert again.json()["job"] == first
