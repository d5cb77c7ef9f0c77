"""Processes of jobs: each job ends, also if its process is killed or hangs."""

import errno
import os
import signal
import time
from multiprocessing import forkserver as fork_server

import pytest

from app.http.logs import LineFormatter
from app.jobs import runner as runner_module
from app.settings import LogFormat
from storage.errors import StorageUnavailable
from tests.support.campus import queue_build
from tests.support.process import is_running, job_processes, until
from tests.support.recording import recording, upload_scan
from tests.support.service import running, wait_for
from tests.support.workers import (
    Undying,
    be_killed_while_it_writes_images,
    be_killed_while_it_writes_its_revision,
    fall_over,
    find_no_catalog,
    lose_the_catalog_for_a_moment,
    never_end,
    take_memory,
)


def _one_worker():
    """Return the process of the running job: it is started a moment after the job is claimed."""
    until(lambda: bool(job_processes()), "no worker was started")
    [worker] = job_processes()
    return worker


def test_a_worker_that_is_killed_fails_its_job_and_the_next_one_is_done(stuck, monkeypatch, caplog):
    job = queue_build(stuck)
    wait_for(stuck, job, {"running"})
    os.kill(_one_worker(), signal.SIGKILL)
    failed = wait_for(stuck, job)
    assert (failed["state"], failed["error"]["type"]) == ("failed", "/problems/worker-died")
    assert "-9" in failed["error"]["detail"]
    until(lambda: "job ended" in caplog.text, "the end is logged")
    [ended] = [record for record in caplog.records if record.getMessage() == "job ended"]
    assert ended.levelname == "WARNING"
    line = LineFormatter(LogFormat.TEXT).format(ended)
    assert f"job={job} map=campus" in line
    assert line.endswith(failed["error"]["detail"])

    monkeypatch.setattr(runner_module, "run_job", fall_over)
    fallen = wait_for(stuck, queue_build(stuck))
    assert "exit code 3" in fallen["error"]["detail"]

    monkeypatch.undo()
    assert wait_for(stuck, queue_build(stuck))["state"] == "done"
    assert stuck.get("/readyz").json() == {"ready": True, "missing": []}


def test_a_killed_build_leaves_no_half_written_images(stuck, monkeypatch):
    monkeypatch.setattr(runner_module, "run_job", be_killed_while_it_writes_images)
    failed = wait_for(stuck, queue_build(stuck))
    assert "exit code -9" in failed["error"]["detail"]
    [images] = stuck.service.store.layout.maps.glob("*/drives/*/images")
    assert not list(images.iterdir())


def test_a_killed_build_leaves_no_half_written_revision(own, monkeypatch):
    [revisions] = own.service.store.layout.maps.glob("*/revisions")
    before = set(revisions.iterdir())
    monkeypatch.setattr(runner_module, "run_job", be_killed_while_it_writes_its_revision)
    failed = wait_for(own, queue_build(own, segments=1, encoding="paper"))
    assert "exit code -9" in failed["error"]["detail"]
    assert set(revisions.iterdir()) == before


def test_a_job_says_why_it_ended_though_what_it_left_cannot_be_removed(stuck, monkeypatch, caplog):
    with monkeypatch.context() as failing:

        def fail(_map_id):
            raise OSError(errno.EIO, "Input/output error")

        failing.setattr(stuck.service.store.revisions, "remove_half_written", fail)
        failing.setattr(runner_module, "run_job", fall_over)
        job = queue_build(stuck)
        failed = wait_for(stuck, job)
    assert (failed["error"]["type"], failed["state"]) == ("/problems/worker-died", "failed")
    assert "the process ended with exit code 3" in failed["error"]["detail"]
    assert f"what job {job} left cannot be removed" in caplog.text
    assert "Input/output error" in caplog.text


def test_a_worker_whose_fork_server_is_killed_is_ended_and_the_next_build_is_done(
    stuck, monkeypatch
):
    job = queue_build(stuck)
    wait_for(stuck, job, {"running"})
    worker = _one_worker()
    os.kill(vars(fork_server._forkserver)["_forkserver_pid"], signal.SIGKILL)
    failed = wait_for(stuck, job)
    assert (failed["state"], failed["error"]["type"]) == ("failed", "/problems/worker-died")
    assert "the process that starts jobs was killed" in failed["error"]["detail"]
    until(lambda: not is_running(worker), "the worker goes on alone")

    monkeypatch.undo()
    assert wait_for(stuck, queue_build(stuck))["state"] == "done"


def test_a_worker_that_cannot_write_down_its_end_reports_it(stuck, monkeypatch):
    monkeypatch.setattr(runner_module, "run_job", find_no_catalog)
    failed = wait_for(stuck, queue_build(stuck))
    assert (failed["state"], failed["error"]["type"]) == ("failed", "/problems/storage-read-only")


def test_a_build_goes_on_while_the_catalog_takes_no_progress(own, monkeypatch):
    monkeypatch.setattr(runner_module, "run_job", lose_the_catalog_for_a_moment)
    done = wait_for(own, queue_build(own, segments=1, encoding="paper"))
    assert done["state"] == "done", done
    assert done["done"] == done["total"] > 0


def test_an_end_that_the_catalog_does_not_take_is_written_down_later(stuck, monkeypatch):
    jobs, refusals = stuck.service.store.jobs, iter([True, True])
    fail = jobs.fail

    def refuse_twice(*arguments):
        if next(refusals, False):
            raise StorageUnavailable("the disk is gone for a moment")
        return fail(*arguments)

    monkeypatch.setattr(jobs, "fail", refuse_twice)
    monkeypatch.setattr(runner_module, "run_job", fall_over)
    failed = wait_for(stuck, queue_build(stuck))
    assert (failed["state"], failed["error"]["type"]) == ("failed", "/problems/worker-died")
    assert next(refusals, None) is None


def test_a_job_whose_start_got_no_answer_is_run(own, monkeypatch):
    jobs, lost = own.service.store.jobs, iter([True])
    claim = jobs.claim

    def claim_and_lose_the_answer(*arguments):
        job = claim(*arguments)
        if job is not None and next(lost, False):
            raise StorageUnavailable("the connection was lost in the commit")
        return job

    monkeypatch.setattr(jobs, "claim", claim_and_lose_the_answer)
    first = queue_build(own, segments=1, encoding="paper")
    second = queue_build(own, segments=2, encoding="paper")
    assert wait_for(own, second)["state"] == "done"
    assert wait_for(own, first)["state"] == "done"
    assert next(lost, None) is None


def test_a_build_without_progress_is_ended_and_fails_by_name(tmp_path, monkeypatch):
    monkeypatch.setattr(runner_module, "run_job", never_end)
    with running(tmp_path, build_stall_s=0.5) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload_scan(client, "campus", "monday", 0, recording().scans[0])
        failed = wait_for(client, queue_build(client))
        assert (failed["state"], failed["error"]["type"]) == ("failed", "/problems/build-stalled")
        assert "no progress for 0.5 s" in failed["error"]["detail"]
        assert not job_processes()
        monkeypatch.undo()
        assert client.get(failed["error"]["type"]).status_code == 200


def test_a_build_with_progress_is_not_ended_however_long_it_takes(tmp_path, monkeypatch):
    monkeypatch.setattr(runner_module, "run_job", never_end)
    with running(tmp_path, build_stall_s=2) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload_scan(client, "campus", "monday", 0, recording().scans[0])
        job = queue_build(client)
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
        failed = wait_for(client, queue_build(client))
        problem = failed["error"]
        assert (failed["state"], problem["type"]) == ("failed", "/problems/build-out-of-memory")
        assert f"more than the {2**30} bytes" in problem["detail"]
        assert not problem["detail"].rstrip().endswith(":")


def test_a_worker_that_cannot_be_ended_fails_its_job_and_the_next_one_is_done(
    tmp_path, monkeypatch
):
    with running(tmp_path, build_stall_s=6) as client:  # a process is started within it
        client.post("/v1/maps", json={"map": "campus"})
        upload_scan(client, "campus", "monday", 0, recording().scans[0])
        context = client.service.runner._context
        with monkeypatch.context() as hanging:
            hanging.setattr(context, "Process", Undying, raising=False)
            hanging.setattr(runner_module, "KILLED_S", 0.05)
            hanging.setattr(runner_module, "_KILL_S", 0.1)
            failed = wait_for(client, queue_build(client))
            assert failed["error"]["type"] == "/problems/build-stalled"
        assert wait_for(client, queue_build(client, segments=1))["state"] == "done"


@pytest.mark.parametrize(
    "error", [OSError("no more processes"), EOFError("unexpected EOF"), MemoryError()], ids=repr
)
def test_a_worker_that_cannot_be_started_fails_its_job_and_not_the_service(
    stuck, monkeypatch, error
):
    def refuse(*_args, **_kwargs):
        raise error

    monkeypatch.setattr(stuck.service.runner._context, "Process", refuse, raising=False)
    job = wait_for(stuck, queue_build(stuck))
    assert (job["state"], job["error"]["type"]) == ("failed", "/problems/worker-died")
    assert stuck.get("/readyz").status_code == 200


def test_a_job_whose_worker_cannot_be_watched_fails_and_the_next_one_is_done(own, monkeypatch):
    with monkeypatch.context() as failing:

        def fail(*_args):
            raise KeyError("worker")

        failing.setattr(own.service.runner, "_watch", fail)
        failed = wait_for(own, queue_build(own))
        assert failed["error"]["type"] == "/problems/worker-died"
        assert "KeyError" in failed["error"]["detail"]
    assert wait_for(own, queue_build(own, segments=1, encoding="paper"))["state"] == "done"


def test_a_build_of_a_deleted_map_is_cancelled_logged_counted_and_still_found(stuck, caplog):
    assert 'tensormap_builds_total{state="cancelled"} 0.0' in stuck.get("/metrics").text
    job = queue_build(stuck)
    wait_for(stuck, job, {"running"})
    with caplog.at_level("INFO", logger="tensormap.jobs"):
        assert stuck.delete("/v1/maps/campus").status_code == 204
        ended = wait_for(stuck, job)
        assert (ended["state"], ended["map"], ended["error"]) == ("cancelled", "campus", None)
        until(lambda: "job ended" in caplog.text, "the end is logged")
    [line] = [record for record in caplog.records if record.getMessage() == "job ended"]
    shown = LineFormatter(LogFormat.TEXT).format(line)
    assert f"job={job} map=campus kind=build state=cancelled" in shown
    counted = 'tensormap_builds_total{state="cancelled"} 1.0'
    until(lambda: counted in stuck.get("/metrics").text, "it is counted")
    assert job_processes() == []
    assert stuck.delete(f"/v1/jobs/{job}").json() == ended
