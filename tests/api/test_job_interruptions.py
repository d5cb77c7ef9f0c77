"""Jobs that run when the service is stopped or dies: the next start continues with them."""

import threading

import pytest

from app.jobs import runner as runner_module
from storage.catalog import JobState
from storage.store import Store
from tests.support.campus import queue_build
from tests.support.process import job_processes
from tests.support.recording import recording, upload_scan
from tests.support.service import running, wait_for
from tests.support.workers import Undying, never_end


def test_a_stopped_service_leaves_no_worker_and_the_next_one_continues(tmp_path, monkeypatch):
    monkeypatch.setattr(runner_module, "run_job", never_end)
    with running(tmp_path) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload_scan(client, "campus", "monday", 0, recording().scans[0])
        job = queue_build(client)
        wait_for(client, job, {"running"})
    assert not job_processes()
    monkeypatch.undo()
    with Store(tmp_path) as store:
        stopped = store.jobs.get(job)
        assert (stopped.state, stopped.crashes) == (JobState.QUEUED, 0)
    with running(tmp_path) as client:
        assert wait_for(client, job)["state"] == JobState.DONE


@pytest.mark.parametrize("in_time", [True, False])
def test_a_stop_while_a_worker_is_started_counts_no_crash(tmp_path, monkeypatch, in_time):
    starting, released = threading.Event(), threading.Event()

    with running(tmp_path) as client:

        def start_slowly(_make):
            starting.set()
            client.service.runner._stopping.wait(60.0)
            if not in_time:
                released.wait(60.0)
            raise OSError("the process that forks was ended")

        client.post("/v1/maps", json={"map": "campus"})
        upload_scan(client, "campus", "monday", 0, recording().scans[0])
        monkeypatch.setattr(client.service.runner, "_start", start_slowly)
        if not in_time:
            monkeypatch.setattr("app.ending.THREADS_S", 0.1)
        job = queue_build(client)
        assert starting.wait(60.0)
    released.set()
    with Store(tmp_path) as store:
        stopped = store.jobs.get(job)
        assert (stopped.state, stopped.crashes) == (JobState.QUEUED, 0)
        store.recover()
        assert store.jobs.get(job).crashes == 0


def test_a_worker_that_does_not_die_at_a_stop_counts_no_crash(tmp_path, monkeypatch, caplog):
    with running(tmp_path) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload_scan(client, "campus", "monday", 0, recording().scans[0])
        monkeypatch.setattr(client.service.runner._context, "Process", Undying, raising=False)
        job = queue_build(client)
        wait_for(client, job, {"running"})
    assert f"the process of job {job} cannot be ended" in caplog.text
    assert "the process ends it" not in caplog.text
    with Store(tmp_path) as store:
        assert store.jobs.requeue_interrupted() == 0
        stopped = store.jobs.get(job)
        assert (stopped.state, stopped.crashes) == (JobState.QUEUED, 0)


@pytest.mark.parametrize(("crashes", "state"), [(4, JobState.DONE), (5, JobState.FAILED)])
def test_a_job_with_which_the_service_has_ended_five_times_fails(tmp_path, crashes, state):
    with Store(tmp_path) as store:
        store.maps.create("campus")
        store.drives.put_scan("campus", "monday", 0, recording().scans[0])
        made = store.jobs.create("campus", {"segments": 1, "encoding": "paper"})
        for _ in range(crashes):
            store.jobs.claim()
            store.recover()
        newer = store.jobs.create("campus", {"segments": 1, "encoding": "paper"})
    with running(tmp_path) as client:
        job = wait_for(client, made.id)
        assert job["state"] == state
        if state == JobState.FAILED:
            assert job["error"]["type"] == "/problems/worker-died"
            assert (
                "while this job ran, the service ended without a stop 5 times"
                in (job["error"]["detail"])
            )
        assert wait_for(client, newer.id)["state"] == JobState.DONE
