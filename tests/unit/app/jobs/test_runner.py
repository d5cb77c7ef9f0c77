"""The watch over the process of a job."""

from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import SecretStr

from app.jobs import runner as runner_module
from app.jobs.runner import JobRunner
from app.settings import Settings
from storage.catalog import BUILD, CAPTURE, JobState
from storage.errors import StorageUnavailable


class Watched:
    """A worker that ends after so many looks at it."""

    def __init__(self, looks):
        self.looks = looks

    def is_alive(self):
        self.looks -= 1
        return self.looks >= 0

    def join(self, timeout_s):
        pass


def test_a_job_is_given_no_key(tmp_path, claimed, monkeypatch):
    _, job = claimed
    given = []

    class Started:
        """A process of a job that is not started."""

        def __init__(self, args, **_):
            given.extend(args)
            raise RuntimeError("not started")

    store: Any = SimpleNamespace()
    settings = Settings(data_dir=tmp_path, admin_key=SecretStr("correct horse battery staple"))
    runner = JobRunner(settings, store)
    monkeypatch.setattr(runner._context, "Process", Started)
    with pytest.raises(RuntimeError):
        runner._run(job)
    assert given[0].admin_key is None
    assert given[0].data_dir == tmp_path


def test_that_a_running_job_cannot_be_read_is_logged_once_and_not_at_each_look(
    tmp_path, claimed, caplog
):
    _, job = claimed

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
    JobRunner(Settings(data_dir=tmp_path), store)._watch(worker, job.id)
    assert caplog.text.count(f"job {job.id} cannot be read") == 2


@pytest.mark.parametrize(
    ("looked_s", "stalled"), [(range(40), True), ([0, 1, 2, 7202, 7203, 7204], False)]
)
def test_time_for_which_the_service_was_frozen_does_not_count_as_without_progress(
    tmp_path, claimed, monkeypatch, looked_s, stalled
):
    _, job = claimed
    clock_s = iter([float(at_s) for at_s in looked_s])
    ticking = SimpleNamespace(monotonic=lambda: next(clock_s))
    store: Any = SimpleNamespace(jobs=SimpleNamespace(get=lambda _id: job))
    settings = Settings(data_dir=tmp_path, build_stall_s=30.0)
    worker: Any = Watched(looks=len(looked_s) - 1)
    with monkeypatch.context() as patched:
        patched.setattr(runner_module, "time", ticking)
        found = JobRunner(settings, store)._watch(worker, job.id)
    assert (found is not None) is stalled


@pytest.mark.parametrize(("kind", "is_ended"), [(CAPTURE, True), (BUILD, False)])
def test_a_capture_whose_reader_does_not_look_at_the_time_is_ended_too(
    tmp_path, monkeypatch, kind, is_ended
):
    """Between two scans it does; a bag's library may take an hour to open one of few kilobytes."""
    progress = iter(range(100))

    def job(_id):
        return SimpleNamespace(
            kind=kind, cancel_requested=False, state=JobState.RUNNING, stage="opening",
            done_units=next(progress), total_units=0,
        )  # fmt: skip

    store: Any = SimpleNamespace(jobs=SimpleNamespace(get=job))
    settings = Settings(data_dir=tmp_path, capture_read_s=60.0, build_stall_s=30.0)
    clock_s = iter(range(200))
    ticking = SimpleNamespace(monotonic=lambda: float(next(clock_s)))
    worker: Any = Watched(looks=100)
    with monkeypatch.context() as patched:
        patched.setattr(runner_module, "time", ticking)
        found = JobRunner(settings, store)._watch(worker, "0" * 32)
    wanted = (
        "CaptureTooSlow",
        "the capture was not read within 60 s, in stage 'opening' after 90 of 0 units",
    )
    assert found == (wanted if is_ended else None)
    assert next(clock_s) == (92 if is_ended else 101)
