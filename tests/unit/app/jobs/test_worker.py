"""What the process of a job stores as the outcome, and what it logs."""

import errno

import pytest

from app.builds.parameters import BuildParameters
from app.builds.plans import plan_build
from app.jobs.worker import run_job
from app.settings import Settings
from core.errors import EmptyDrive
from storage.catalog import JobState
from storage.errors import JobNotFound, StorageFull


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


def test_a_job_that_fails_for_a_reason_of_its_own_is_not_logged_by_its_process_too(
    tmp_path, claimed, monkeypatch, caplog
):
    def refuse(*_args, **_options):
        raise EmptyDrive("drive 'monday' has no scan")

    store, job = claimed
    monkeypatch.setattr("app.jobs.worker.build_revision", refuse)
    run_job(Settings(data_dir=tmp_path), job)
    assert store.jobs.get(job.id).error_type == "EmptyDrive"
    assert "no scan" not in caplog.text  # the service logs the end of each job with its reason


def test_why_a_disk_failed_a_job_is_in_the_log_and_not_in_the_job(
    tmp_path, claimed, monkeypatch, caplog
):
    def fail(*_, **__):
        raise StorageFull("no space is left") from OSError(errno.ENOSPC, "full", "/inside")

    store, job = claimed
    monkeypatch.setattr("app.jobs.worker.build_revision", fail)
    run_job(Settings(data_dir=tmp_path), job)
    assert store.jobs.get(job.id).error_detail == "no space is left"
    assert "/inside" in caplog.text
