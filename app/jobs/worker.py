"""The process of one job: a build, or the reading of a capture."""

import logging
import os
import threading
import time
from contextlib import suppress
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait

from app.builds.parameters import BuildParameters
from app.builds.plans import Plan, plan_build
from app.builds.revision_build import build_revision
from app.captures.reading import read_capture
from app.http.errors import BuildOutOfMemory
from app.http.logs import configure_logging
from app.process import (
    end_before_others,
    keep_freed_memory,
    limited_memory,
    one_blas_thread,
    private_files,
)
from app.settings import Settings
from core.errors import Cancelled, TensorMapError
from core.progress import Progress
from storage.catalog import CAPTURE, JobRecord
from storage.errors import (
    BasisNotFound,
    DriveNotFound,
    JobNotFound,
    MapNotFound,
    RevisionNotFound,
    StorageFailure,
    with_cause,
)
from storage.store import Store

_REPORT_EVERY_S = 0.2
_REPORT_AGAIN_S = 10.0  # where the catalog is locked each attempt waits for it

_PLANNED = DriveNotFound, BasisNotFound, RevisionNotFound

_log = logging.getLogger("tensormap.jobs")


def run_job(
    settings: Settings, job: JobRecord, memory_bytes: int = 0, report: Connection | None = None
) -> None:
    """Run one claimed job to its end and store its outcome.

    Args:
        settings: The service's settings.
        job: The claimed job.
        memory_bytes: How much the job may allocate, 0 for any amount.
        report: Receives the name and text of an error that the catalog does not store.

    Raises:
        TensorMapError: If the outcome cannot be stored, and there is no `report`.
    """
    if parent_process() is not None:  # the logging and memory are this process's own
        configure_logging(settings.log_format, settings.log_level)
        keep_freed_memory()
        private_files()
        end_before_others()
    _end_with_parent()
    one_blas_thread()
    try:
        _run(settings, job, memory_bytes)
    except TensorMapError as error:
        if report is None:
            raise
        _log.error("the outcome of job %s cannot be stored: %s", job.id, with_cause(error))
        report.send((type(error).__name__, str(error)))


def _run(settings: Settings, job: JobRecord, memory_bytes: int) -> None:
    with (
        Store(settings.data_dir, settings.catalog_url) as store,
        suppress(JobNotFound),  # removed with its map
    ):
        progress = _JobProgress(store, job.id)
        try:
            store.hold()
            with limited_memory(memory_bytes):
                _work(store, settings, job, progress)
        except MemoryError as error:
            detail = f"the {job.kind} needs more than the {memory_bytes} bytes that it may take"
            if str(error):  # NumPy's says for what
                detail += f": {error}"
            store.jobs.fail(job.id, BuildOutOfMemory.__name__, detail)
        except (Cancelled, MapNotFound):  # the latter where its map was deleted
            store.jobs.cancelled(job.id)
        except TensorMapError as error:
            if isinstance(error, StorageFailure):  # the job itself does not have the cause
                _log.warning("job %s failed: %s", job.id, with_cause(error))
            store.jobs.fail(job.id, type(error).__name__, str(error))


def _work(store: Store, settings: Settings, job: JobRecord, progress: Progress) -> None:
    if job.kind == CAPTURE:
        read = read_capture(store, settings, job, progress)
        store.jobs.finish(job.id, None, notes=read.notes, result=read.as_json())
        return
    plan = _plan(store, job)
    try:
        record = build_revision(store, job.map_id, plan, progress, job_id=job.id)
    except _PLANNED as error:  # the plan names those that there were
        raise type(error)(f"{error}: it was deleted after this build was queued") from error
    store.jobs.finish(job.id, record.digest)


def _plan(store: Store, job: JobRecord) -> Plan:
    """Return the plan that was made when the job was queued; earlier versions stored none."""
    if job.plan is not None:
        return Plan.model_validate(job.plan)
    return plan_build(store, job.map_id, BuildParameters.model_validate(job.parameters))


class _JobProgress:
    """Writes progress into the catalog, and stops the work when the job is cancelled."""

    def __init__(self, store: Store, job_id: str) -> None:
        self._store = store
        self._job_id = job_id
        self._stage, self._done, self._total = "", 0, 0
        self._due_at = 0.0

    def start(self, stage: str, total: int) -> None:
        self._stage, self._done, self._total = stage, 0, total
        self._report()

    def advance(self, units: int = 1) -> None:
        self._done += units
        if self._done >= self._total or time.monotonic() >= self._due_at:
            self._report()

    def _report(self) -> None:
        """Write the progress; where the catalog cannot take it, go on and try later."""
        try:
            job = self._store.jobs.progress(self._job_id, self._stage, self._done, self._total)
        except StorageFailure as error:  # hours of work are worth more
            _log.warning("job %s goes on without progress: %s", self._job_id, with_cause(error))
            self._due_at = time.monotonic() + _REPORT_AGAIN_S
            return
        self._due_at = time.monotonic() + _REPORT_EVERY_S
        if job.cancel_requested:
            raise Cancelled(f"job {self._job_id} was cancelled")


def _end_with_parent() -> None:
    """End this process with the service, even if that was killed: the job is queued again."""
    parent = parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
