"""Processes of jobs: each job ends, also if its process is killed or hangs."""

import errno
import os
import signal
import threading
import time
from multiprocessing import forkserver as fork_server
from types import SimpleNamespace
from typing import Any

import pytest

from app.builds.parameters import BuildParameters
from app.builds.plans import plan_build
from app.http.logs import LineFormatter
from app.jobs import runner as runner_module
from app.jobs.runner import JobRunner
from app.jobs.worker import run_job
from app.settings import LogFormat, Settings
from core.errors import EmptyDrive
from storage.catalog import JobState
from storage.errors import JobNotFound, StorageFull, StorageUnavailable
from storage.store import Store
from tests.support.campus import queue_build
from tests.support.process import is_running, job_processes, until
from tests.support.recording import recording, upload_scan
from tests.support.service import running, wait_for
from tests.support.workers import (
    be_killed_while_it_writes_images,
    fall_over,
    find_no_catalog,
    lose_the_catalog_for_a_moment,
    never_end,
    take_memory,
)


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


def test_a_job_that_fails_for_a_reason_of_its_own_is_not_logged_by_its_process_too(
    stuck, monkeypatch, caplog
):
    def refuse(*_args, **_options):
        raise EmptyDrive("drive 'monday' has no scan")

    job = wait_for(stuck, queue_build(stuck), {"running"})["job"]
    monkeypatch.setattr("app.jobs.worker.build_revision", refuse)
    run_job(stuck.service.settings, stuck.service.store.jobs.get(job))
    assert stuck.get(f"/v1/jobs/{job}").json()["state"] == "failed"
    assert "no scan" not in caplog.text  # the service logs the end of each job with its reason


def test_why_a_disk_failed_a_job_is_in_the_log_and_not_in_the_job(stuck, monkeypatch, caplog):
    def fail(*_, **__):
        raise StorageFull("no space is left") from OSError(errno.ENOSPC, "full", "/inside")

    job = wait_for(stuck, queue_build(stuck), {"running"})["job"]
    monkeypatch.setattr("app.jobs.worker.build_revision", fail)
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
        time.sleep(timeout)

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


class Watched:
    """A worker that ends after so many looks at it."""

    def __init__(self, looks):
        self.looks = looks

    def is_alive(self):
        self.looks -= 1
        return self.looks >= 0

    def join(self, timeout_s):
        pass


def test_that_a_running_job_cannot_be_read_is_logged_once_and_not_at_each_look(own, caplog):
    job = own.service.store.jobs.get(queue_build(own))
    wait_for(own, job.id)

    class Outages:
        """Two outages of five looks each, and one look between them."""

        looks = 0

        def get(self, job_id):
            self.looks += 1
            if self.looks == 6:
                return job
            raise StorageUnavailable("the database restarts")

    store: Any = SimpleNamespace(jobs=Outages())
    worker: Any = Watched(looks=11)
    JobRunner(own.service.settings, store)._watch(worker, job.id)
    assert caplog.text.count(f"job {job.id} cannot be read") == 2


@pytest.mark.parametrize(
    ("looked_s", "stalled"), [(range(40), True), ([0, 1, 2, 7202, 7203, 7204], False)]
)
def test_time_for_which_the_service_was_frozen_does_not_count_as_without_progress(
    own, monkeypatch, looked_s, stalled
):
    job = own.service.store.jobs.get(queue_build(own))
    wait_for(own, job.id)
    clock_s = iter([float(at_s) for at_s in looked_s])
    ticking = SimpleNamespace(monotonic=lambda: next(clock_s))
    store: Any = SimpleNamespace(jobs=SimpleNamespace(get=lambda _id: job))
    settings = own.service.settings.model_copy(update={"build_stall_s": 30.0})
    worker: Any = Watched(looks=len(looked_s) - 1)
    with monkeypatch.context() as patched:
        patched.setattr(runner_module, "time", ticking)
        found = JobRunner(settings, store)._watch(worker, job.id)
    assert (found is not None) is stalled


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


@pytest.mark.parametrize("action", ["delete", "purge"])
def test_a_worker_whose_map_is_deleted_or_removed_ends_quietly(tmp_path, claimed, caplog, action):
    store, job = claimed
    getattr(store.maps, action)("campus")
    run_job(Settings(data_dir=tmp_path), job)
    assert caplog.records == []
    if action == "delete":
        assert store.jobs.get(job.id).state is JobState.CANCELLED
    else:
        with pytest.raises(JobNotFound):
            store.jobs.get(job.id)


def test_a_build_whose_drive_is_deleted_fails_and_says_when(tmp_path, claimed):
    store, _ = claimed
    plan = plan_build(store, store.maps.get("campus").id, BuildParameters())
    made = store.jobs.create("campus", {}, plan=plan.model_dump(mode="json"))
    job = store.jobs.claim()
    store.drives.delete("campus", "monday")
    run_job(Settings(data_dir=tmp_path), job)
    failed = store.jobs.get(made.id)
    assert (failed.state, failed.error_type) == (JobState.FAILED, "DriveNotFound")
    assert failed.error_detail == (
        "map 'campus' has no drive 'monday': it was deleted after this build was queued"
    )


@pytest.mark.parametrize(
    ("lost", "error", "detail"),
    [
        ("basis", "BasisNotFound", f"there is no shared basis '{'d' * 64}'"),
        ("basis_kept_from", "RevisionNotFound", f"map 'campus' has no revision '{'d' * 64}'"),
    ],
)
def test_a_build_whose_basis_is_deleted_fails_and_says_when(tmp_path, claimed, lost, error, detail):
    store, _ = claimed
    plan = plan_build(store, store.maps.get("campus").id, BuildParameters())
    lacking = plan.model_copy(update={lost: "d" * 64})
    made = store.jobs.create("campus", {}, plan=lacking.model_dump(mode="json"))
    job = store.jobs.claim()
    run_job(Settings(data_dir=tmp_path), job)
    failed = store.jobs.get(made.id)
    assert (failed.state, failed.error_type) == (JobState.FAILED, error)
    assert failed.error_detail == f"{detail}: it was deleted after this build was queued"


def _one_worker():
    """Return the process of the running job: it is started a moment after the job is claimed."""
    deadline = time.monotonic() + 60
    while not (workers := job_processes()):
        assert time.monotonic() < deadline, "no worker was started"
        time.sleep(0.02)
    [worker] = workers
    return worker


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
