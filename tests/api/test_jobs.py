"""Builds as jobs: each one ends, also if its process is killed."""

import errno
import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import active_children
from multiprocessing import forkserver as fork_server

import numpy as np
import pytest

from app.builds import runner as runner_module
from app.builds.worker import run_job
from app.http.logs import LineFormatter, LogFormat
from app.settings import Settings
from core.scans.scan import Scan
from storage.catalog import JobState
from storage.errors import JobNotFound, StorageBusy, StorageFull, StorageUnavailable
from storage.store import Store
from tests.support.process import is_running, until
from tests.support.recording import recording, upload_scan
from tests.support.service import problem_of, running, wait_for, whole_store
from tests.support.workers import (
    fall_over,
    find_no_catalog,
    lose_the_catalog_for_a_moment,
    never_end,
    take_memory,
)


def build(client, **parameters):
    response = client.post("/v1/maps/campus/builds", json=parameters)
    assert response.status_code == 202, response.text
    return response.json()["job"]


@pytest.fixture
def stuck(empty, monkeypatch):
    """A service whose workers never end, with one scan."""
    monkeypatch.setattr(runner_module, "run_job", never_end)
    upload_scan(empty, "campus", "monday", 0, recording().scans[0])
    return empty


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
    job = wait_for(empty, build(empty, encoding="paper"))
    assert job["state"] == "failed"
    assert job["error"]["type"] == "/problems/empty-drive"
    assert "sky" in job["error"]["detail"]
    assert empty.get(job["error"]["type"]).status_code == 200
    maps, drives, revisions, _ = whole_store(empty)
    assert (maps, drives, revisions) == before[:3]


def test_a_worker_that_is_killed_fails_its_job_and_the_next_one_is_done(stuck, monkeypatch, caplog):
    job = build(stuck)
    wait_for(stuck, job, {"running"})
    os.kill(_one_worker(), signal.SIGKILL)
    failed = wait_for(stuck, job)
    assert (failed["state"], failed["error"]["type"]) == ("failed", "/problems/worker-died")
    assert "-9" in failed["error"]["detail"]
    until(lambda: "job ended" in caplog.text, "the end is logged")
    [ended] = [record for record in caplog.records if record.getMessage() == "job ended"]
    assert ended.levelname == "WARNING"
    line = LineFormatter(LogFormat.TEXT).format(ended)
    assert f"job={job}" in line
    assert line.endswith(failed["error"]["detail"])

    monkeypatch.setattr(runner_module, "run_job", fall_over)
    fallen = wait_for(stuck, build(stuck))
    assert "exit code 3" in fallen["error"]["detail"]

    monkeypatch.undo()
    assert wait_for(stuck, build(stuck))["state"] == "done"
    assert stuck.get("/readyz").json() == {"ready": True, "missing": []}


def test_a_worker_whose_fork_server_is_killed_is_ended_and_the_next_build_is_done(
    stuck, monkeypatch
):
    job = build(stuck)
    wait_for(stuck, job, {"running"})
    worker = _one_worker()
    os.kill(vars(fork_server._forkserver)["_forkserver_pid"], signal.SIGKILL)
    failed = wait_for(stuck, job)
    assert (failed["state"], failed["error"]["type"]) == ("failed", "/problems/worker-died")
    assert "the process that starts jobs was killed" in failed["error"]["detail"]
    until(lambda: not is_running(worker), "the worker goes on alone")

    monkeypatch.undo()
    assert wait_for(stuck, build(stuck))["state"] == "done"


def test_a_worker_that_cannot_write_down_its_end_reports_it(stuck, monkeypatch):
    monkeypatch.setattr(runner_module, "run_job", find_no_catalog)
    failed = wait_for(stuck, build(stuck))
    assert (failed["state"], failed["error"]["type"]) == ("failed", "/problems/storage-read-only")


def test_a_build_goes_on_while_the_catalog_takes_no_progress(own, monkeypatch):
    monkeypatch.setattr(runner_module, "run_job", lose_the_catalog_for_a_moment)
    done = wait_for(own, build(own, segments=1))
    assert done["state"] == "done", done
    assert done["done"] == done["total"] > 0


def test_why_a_disk_failed_a_job_is_in_the_log_and_not_in_the_job(stuck, monkeypatch, caplog):
    def fail(*_, **__):
        raise StorageFull("no space is left") from OSError(errno.ENOSPC, "full", "/inside")

    job = wait_for(stuck, build(stuck), {"running"})["job"]
    monkeypatch.setattr("app.builds.worker.build_revision", fail)
    run_job(stuck.service.settings, stuck.service.store.jobs.get(job))
    assert stuck.get(f"/v1/jobs/{job}").json()["error"]["detail"] == "no space is left"
    assert "/inside" in caplog.text


def test_an_end_that_the_catalog_does_not_take_is_written_down_later(stuck, monkeypatch):
    jobs, refusals = stuck.service.store.jobs, iter([True, True])
    fail = jobs.fail

    def refuse_twice(*arguments):
        if next(refusals, False):
            raise StorageUnavailable("the disk is gone for a moment")
        return fail(*arguments)

    monkeypatch.setattr(jobs, "fail", refuse_twice)
    monkeypatch.setattr(runner_module, "run_job", fall_over)
    failed = wait_for(stuck, build(stuck))
    assert (failed["state"], failed["error"]["type"]) == ("failed", "/problems/worker-died")
    assert next(refusals, None) is None


def test_a_build_without_progress_is_ended_and_fails_by_name(tmp_path, monkeypatch):
    monkeypatch.setattr(runner_module, "run_job", never_end)
    with running(tmp_path, build_stall_s=0.5) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload_scan(client, "campus", "monday", 0, recording().scans[0])
        failed = wait_for(client, build(client))
        assert (failed["state"], failed["error"]["type"]) == ("failed", "/problems/build-stalled")
        assert "no progress for 0.5 s" in failed["error"]["detail"]
        assert not _workers()
        monkeypatch.undo()
        assert client.get(failed["error"]["type"]).status_code == 200


def test_a_build_with_progress_is_not_ended_however_long_it_takes(tmp_path, monkeypatch):
    monkeypatch.setattr(runner_module, "run_job", never_end)
    with running(tmp_path, build_stall_s=2) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload_scan(client, "campus", "monday", 0, recording().scans[0])
        job = build(client)
        wait_for(client, job, {"running"})
        for done in range(12):
            client.service.store.jobs.progress(job, "fitting", done, 12)
            time.sleep(0.2)
        assert client.get(f"/v1/jobs/{job}").json()["state"] == "running"
        assert wait_for(client, job)["error"]["detail"].endswith("after 11 of 12 units")


def test_a_build_that_needs_too_much_memory_fails_by_name(tmp_path, monkeypatch):
    monkeypatch.setattr(runner_module, "run_job", take_memory)
    with running(tmp_path, build_memory_bytes=2**30) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload_scan(client, "campus", "monday", 0, recording().scans[0])
        failed = wait_for(client, build(client))
        problem = failed["error"]
        assert (failed["state"], problem["type"]) == ("failed", "/problems/build-out-of-memory")
        assert f"more than the {2**30} bytes" in problem["detail"]
        assert not problem["detail"].rstrip().endswith(":")


class Undying:
    """A process that waits for a disk that hangs: not even SIGKILL ends it."""

    exitcode = None

    def __init__(self, **_):
        pass

    def start(self):
        pass

    def kill(self):
        pass

    def join(self, timeout=None):
        assert timeout is not None, "the service would wait for ever"
        time.sleep(min(timeout, 0.05))

    def is_alive(self):
        return True

    def close(self):
        raise ValueError("Cannot close a process while it is still running.")


def test_a_worker_that_cannot_be_ended_fails_its_job_and_the_next_one_is_done(
    tmp_path, monkeypatch
):
    with running(tmp_path, build_stall_s=6) as client:  # a process is started within it
        client.post("/v1/maps", json={"map": "campus"})
        upload_scan(client, "campus", "monday", 0, recording().scans[0])
        context = client.service.runner._context
        with monkeypatch.context() as hanging:
            hanging.setattr(context, "Process", Undying, raising=False)
            failed = wait_for(client, build(client))
            assert failed["error"]["type"] == "/problems/build-stalled"
        assert wait_for(client, build(client, segments=1))["state"] == "done"


@pytest.mark.parametrize(
    "error", [OSError("no more processes"), EOFError("unexpected EOF"), MemoryError()], ids=repr
)
def test_a_worker_that_cannot_be_started_fails_its_job_and_not_the_service(
    stuck, monkeypatch, error
):
    def refuse(*_args, **_kwargs):
        raise error

    monkeypatch.setattr(stuck.service.runner._context, "Process", refuse, raising=False)
    job = wait_for(stuck, build(stuck))
    assert (job["state"], job["error"]["type"]) == ("failed", "/problems/worker-died")
    assert stuck.get("/readyz").status_code == 200


def test_a_job_whose_worker_cannot_be_watched_fails_and_the_next_one_is_done(own, monkeypatch):
    with monkeypatch.context() as failing:

        def fail(*_args):
            raise KeyError("worker")

        failing.setattr(own.service.runner, "_watch", fail)
        failed = wait_for(own, build(own))
        assert failed["error"]["type"] == "/problems/worker-died"
        assert "KeyError" in failed["error"]["detail"]
    assert wait_for(own, build(own, segments=1))["state"] == "done"


def test_builds_go_on_where_the_queue_or_what_follows_a_build_fails(own, monkeypatch):
    service = own.service
    errors = [KeyError("ended"), MemoryError()]
    claim = service.store.jobs.claim

    def fail_once(*_args):
        if errors:
            raise errors.pop()

    def claim_or_fail():
        fail_once()
        return claim()

    monkeypatch.setattr(service.runner, "_ended", fail_once)
    monkeypatch.setattr(service.store.jobs, "claim", claim_or_fail)
    assert wait_for(own, build(own))["state"] == "done"
    errors.append(KeyError("ended"))
    assert wait_for(own, build(own, segments=1))["state"] == "done"
    until(lambda: not errors, "what follows a build was not done")
    assert own.get("/readyz").status_code == 200


def test_a_waiting_and_a_running_build_are_cancelled(stuck):
    first, second = build(stuck), build(stuck)
    wait_for(stuck, first, {"running"})
    assert stuck.get(f"/v1/jobs/{second}").json()["state"] == "queued"
    for job in (second, first):
        assert stuck.delete(f"/v1/jobs/{job}").status_code == 200
        assert wait_for(stuck, job)["state"] == "cancelled"
    assert not _workers()
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
    jobs = [build(stuck) for _ in range(3)]
    listed = stuck.get("/v1/jobs", params={"map": "campus", "limit": 2}).json()
    assert [item["job"] for item in listed["items"]] == [jobs[2], jobs[1]]
    rest = stuck.get("/v1/jobs", params={"map": "campus", "after": listed["next_after"]}).json()
    assert [item["job"] for item in rest["items"]] == [jobs[0]]
    assert stuck.get("/v1/jobs", params={"map": "other"}).json()["items"] == []
    assert problem_of(stuck.get("/v1/jobs", params={"map": "x"})) == (404, "map-not-found")


def test_the_job_of_a_map_that_is_removed_goes_with_it(stuck):
    job = build(stuck)
    wait_for(stuck, job, {"running"})
    stuck.delete("/v1/maps/campus")
    assert problem_of(stuck.get(f"/v1/jobs/{job}")) == (404, "job-not-found")
    deadline = time.monotonic() + 30
    while _workers():
        assert time.monotonic() < deadline, "the worker continues without its map"
        time.sleep(0.02)


def test_a_stopped_service_leaves_no_worker_and_the_next_one_continues(tmp_path, monkeypatch):
    monkeypatch.setattr(runner_module, "run_job", never_end)
    with running(tmp_path) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload_scan(client, "campus", "monday", 0, recording().scans[0])
        job = build(client)
        wait_for(client, job, {"running"})
    assert not _workers()
    monkeypatch.undo()
    with running(tmp_path) as client:
        assert wait_for(client, job)["state"] == JobState.DONE


@pytest.fixture
def claimed(tmp_path):
    """A store with one scan and a build that is claimed, as a worker finds it."""
    with Store(tmp_path) as store:
        store.maps.create("campus")
        store.drives.put_scan("campus", "monday", 0, recording().scans[0])
        store.jobs.create("campus", {})
        job = store.jobs.claim()
        assert job is not None
        yield store, job


def test_a_cancelled_worker_publishes_nothing(tmp_path, claimed):
    store, job = claimed
    store.jobs.request_cancel(job.id)
    run_job(Settings(data_dir=tmp_path), job)
    assert store.jobs.get(job.id).state == JobState.CANCELLED
    assert store.revisions.list("campus").items == ()
    assert not list(tmp_path.rglob("*.part"))


def test_a_worker_whose_map_is_removed_ends_quietly(tmp_path, claimed):
    store, job = claimed
    store.maps.delete("campus")
    run_job(Settings(data_dir=tmp_path), job)
    with pytest.raises(JobNotFound):
        store.jobs.get(job.id)


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


def _one_worker():
    """Return the process of the running job: it is started a moment after the job is claimed."""
    deadline = time.monotonic() + 60
    while not (workers := _workers()):
        assert time.monotonic() < deadline, "no worker was started"
        time.sleep(0.02)
    [worker] = workers
    return worker


def _workers():
    return [
        child.pid for child in active_children() if child.name.startswith("build-") and child.pid
    ]
