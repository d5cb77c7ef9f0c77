"""Builds as jobs: what is queued, in which order it runs, and how it is cancelled."""

import logging
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from core.scans.scan import Scan
from storage.errors import StorageBusy
from tests.support.campus import queue_build
from tests.support.process import job_processes, until
from tests.support.recording import recording, upload_scan
from tests.support.service import problem_of, wait_for, whole_store


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"drives": ["nowhere"]}, (404, "drive-not-found")),
        ({"drives": []}, (422, "invalid-request")),
        ({"drives": ["monday", "monday"]}, (422, "invalid-request")),
        ({"segments": 2, "segment_length": 3}, (422, "invalid-request")),
        ({"segments": 0}, (422, "invalid-request")),
        ({"segment_length": 10**30}, (422, "invalid-request")),
        ({"ranks": [31, 5]}, (422, "invalid-parameters")),
        ({"ranks": [5]}, (422, "invalid-request")),
        ({"sensor": "camera"}, (422, "invalid-parameters")),
        ({"encoding": "none"}, (422, "invalid-request")),
        ({"colour": "red"}, (422, "invalid-request")),
    ],
)
def test_an_impossible_build_is_rejected_before_it_is_queued(client, parameters, problem):
    before = client.get("/v1/jobs").json()
    refused = client.post("/v1/maps/campus/builds", json=parameters)
    assert problem_of(refused) == problem
    assert client.get("/v1/jobs").json() == before


def test_a_map_without_scans_or_that_is_not_there_is_not_built(empty):
    assert problem_of(empty.post("/v1/maps/campus/builds", json={})) == (422, "empty-drive")
    assert problem_of(empty.post("/v1/maps/x/builds", json={})) == (404, "map-not-found")
    assert problem_of(empty.get("/v1/jobs/nonsense")) == (404, "job-not-found")


def test_a_build_that_fails_has_a_reason_and_publishes_nothing(empty):
    above = np.tile([1.0, 0.0, 100.0], (200, 1))  # 89 degrees up, where the grid ends at 4
    for index in range(3):
        upload_scan(empty, "campus", "sky", index, Scan.from_returns(above))
    before = whole_store(empty)
    job = wait_for(empty, queue_build(empty, encoding="paper"))
    assert job["state"] == "failed"
    assert job["error"]["type"] == "/problems/empty-drive"
    assert "sky" in job["error"]["detail"]
    assert empty.get(job["error"]["type"]).status_code == 200
    maps, drives, revisions, _ = whole_store(empty)
    assert (maps, drives, revisions) == before[:3]


def test_builds_go_on_where_the_queue_or_what_follows_a_build_fails(own, monkeypatch):
    service = own.service
    errors = [KeyError("ended"), MemoryError()]
    claim = service.store.jobs.claim

    def fail_once(*_args):
        if errors:
            raise errors.pop()

    def claim_or_fail(*args):
        fail_once()
        return claim(*args)

    monkeypatch.setattr(service.runner, "_ended", fail_once)
    monkeypatch.setattr(service.store.jobs, "claim", claim_or_fail)
    assert wait_for(own, queue_build(own, encoding="paper"))["state"] == "done"
    errors.append(KeyError("ended"))
    assert wait_for(own, queue_build(own, segments=1, encoding="paper"))["state"] == "done"
    until(lambda: not errors, "what follows a build was not done")
    assert own.get("/readyz").status_code == 200


def test_a_waiting_and_a_running_build_are_cancelled(stuck):
    first, second = queue_build(stuck), queue_build(stuck)
    wait_for(stuck, first, {"running"})
    assert stuck.get(f"/v1/jobs/{second}").json()["state"] == "queued"
    for job in (second, first):
        assert stuck.delete(f"/v1/jobs/{job}").status_code == 200
        assert wait_for(stuck, job)["state"] == "cancelled"
    assert not job_processes()
    again = stuck.delete(f"/v1/jobs/{first}")
    assert again.json()["state"] == "cancelled"  # one that ended stays as it is


def test_a_repeated_request_with_its_idempotency_key_is_the_same_job(stuck):
    def post_build(**parameters):
        headers = {"Idempotency-Key": "5a7e-first"}
        return stuck.post("/v1/maps/campus/builds", json=parameters, headers=headers)

    first = post_build(segments=1)
    wait_for(stuck, first.json()["job"], {"running"})
    again = post_build(segments=1)
    assert (again.status_code, again.headers["Location"]) == (202, first.headers["Location"])
    assert (again.json()["job"], again.json()["state"]) == (first.json()["job"], "running")
    assert problem_of(post_build(segments=2)) == (409, "request-key-reused")
    # What it was made of may be gone since: it was made.
    assert stuck.delete("/v1/maps/campus/drives/monday").status_code == 204
    assert post_build(segments=1).json()["job"] == first.json()["job"]
    assert len(stuck.get("/v1/jobs").json()["items"]) == 1


@pytest.mark.parametrize("key", ["", "x" * 256, "two words", "ä"])
def test_a_key_that_no_header_should_hold_is_refused(stuck, key):
    headers = {"Idempotency-Key": key.encode("latin-1")}
    refused = stuck.post("/v1/maps/campus/builds", json={}, headers=headers)
    assert problem_of(refused) == (422, "invalid-request")
    assert stuck.get("/v1/jobs").json()["items"] == []


def test_the_jobs_of_a_map_are_listed_newest_first(stuck):
    stuck.post("/v1/maps", json={"map": "other"})
    jobs = [queue_build(stuck) for _ in range(3)]
    listed = stuck.get("/v1/jobs", params={"map": "campus", "limit": 2}).json()
    assert [item["job"] for item in listed["items"]] == [jobs[2], jobs[1]]
    rest = stuck.get("/v1/jobs", params={"map": "campus", "after": listed["next_after"]}).json()
    assert [item["job"] for item in rest["items"]] == [jobs[0]]
    assert stuck.get("/v1/jobs", params={"map": "other"}).json()["items"] == []
    assert problem_of(stuck.get("/v1/jobs", params={"map": "x"})) == (404, "map-not-found")


def test_the_job_of_a_map_that_is_removed_goes_with_it(stuck):
    job = queue_build(stuck)
    wait_for(stuck, job, {"running"})
    stuck.delete("/v1/maps/campus?purge=true")
    assert problem_of(stuck.get(f"/v1/jobs/{job}")) == (404, "job-not-found")
    deadline = time.monotonic() + 30
    while job_processes():
        assert time.monotonic() < deadline, "the worker continues without its map"
        time.sleep(0.02)


def test_that_the_catalog_cannot_be_read_is_logged_once_however_often_a_probe_asks(
    empty, monkeypatch, caplog
):
    def busy(*_args, **_options):
        raise StorageBusy("another process holds it")

    caplog.set_level(logging.INFO, "tensormap.health")
    with monkeypatch.context() as outage:
        outage.setattr(empty.service.store.maps, "list", busy)
        assert [empty.get("/readyz").status_code for _ in range(3)] == [503] * 3
    assert empty.get("/readyz").status_code == 200
    logged = [record.getMessage() for record in caplog.records if "catalog" in record.getMessage()]
    assert logged == [
        "the catalog cannot be read: another process holds it",
        "this is over: the catalog cannot be read",
    ]


def test_readiness_names_what_is_missing(empty, monkeypatch):
    assert empty.get("/readyz").json() == {"ready": True, "missing": []}

    def busy(*_args, **_options):
        raise StorageBusy("another process holds it")

    monkeypatch.setattr(empty.service.store.maps, "list", busy)
    monkeypatch.setattr(type(empty.service.runner), "alive", False)
    answer = empty.get("/readyz")
    assert answer.status_code == 503
    assert answer.json() == {
        "ready": False,
        "missing": [
            "the catalog cannot be read: another process holds it",
            "builds do not run",
        ],
    }
    assert empty.get("/livez").status_code == 200
    refused = empty.get("/v1/maps")
    assert problem_of(refused) == (503, "storage-busy")


def test_the_service_is_alive_while_every_thread_of_it_waits(own, monkeypatch):
    let_go, requested = threading.Event(), threading.Semaphore(0)

    def wait(*_args):
        requested.release()
        assert let_go.wait(60)
        raise TimeoutError

    monkeypatch.setattr(own.service.revisions, "live", wait)
    with ThreadPoolExecutor(60) as pool:
        try:
            slow = [pool.submit(own.get, "/v1/maps/campus/topology") for _ in range(60)]
            for _ in range(own.service.settings.heavy_threads_per_key):
                assert requested.acquire(timeout=60)
            assert own.get("/livez").json() == {"status": "live"}
            # What is read of the catalog only has threads of its own.
            assert own.get("/v1/maps/campus").status_code == 200
        finally:
            let_go.set()
        assert {answer.result().status_code for answer in slow} == {500}


def test_a_job_names_its_map_where_it_is_queued_listed_shown_and_followed(empty):
    upload_scan(empty, "campus", "monday", 0, recording().scans[0])
    queued = empty.post("/v1/maps/campus/builds", json={}).json()
    assert queued["map"] == "campus"
    job = queued["job"]
    ended = wait_for(empty, job)
    assert ended["map"] == "campus"
    assert empty.get("/v1/jobs").json()["items"] == [ended]
    assert '"map":"campus"' in empty.get(f"/v1/jobs/{job}/events").text


def test_jobs_are_listed_by_their_states(stuck):
    running, queued, cancelled = (queue_build(stuck) for _ in range(3))
    wait_for(stuck, running, {"running"})
    stuck.delete(f"/v1/jobs/{cancelled}")

    def listed(query):
        return [job["job"] for job in stuck.get(f"/v1/jobs?{query}").json()["items"]]

    assert listed("state=running") == [running]
    assert listed("state=queued&state=running&map=campus") == [queued, running]
    assert listed("state=cancelled") == [cancelled]
    assert listed("state=done") == []
    assert listed("") == [cancelled, queued, running]
    refused = stuck.get("/v1/jobs?state=waiting")
    assert problem_of(refused) == (422, "invalid-request")
    assert "'queued', 'running', 'done', 'failed' or 'cancelled'" in refused.text
