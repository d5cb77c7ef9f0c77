"""The process of one build."""

import os
import threading
import time
from contextlib import suppress
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from pathlib import Path

from app.builds.parameters import BuildParameters
from app.builds.pipelines import build_revision
from app.builds.plans import Plan, plan_build
from app.http.errors import BuildOutOfMemory
from app.http.logs import LogFormat, configure_logging
from app.process import keep_freed_memory, limited_memory, one_blas_thread, private_files
from core.errors import Cancelled, TensorMapError
from storage.catalog import JobRecord
from storage.errors import JobNotFound
from storage.store import Store

IMPORTED_LATE = ("scipy.optimize", "sqlalchemy.dialects.sqlite")
"""Modules that every build needs, imported when they are used: not everybody who uses us does."""

_REPORT_EVERY_S = 0.2


def run_build(
    data_dir: Path,
    catalog_url: str | None,
    job: JobRecord,
    log_format: LogFormat = LogFormat.TEXT,
    log_level: str = "INFO",
    memory_bytes: int = 0,
    report: Connection | None = None,
) -> None:
    """Run one claimed job to its end and write down how it ended.

    Args:
        data_dir: Where the store is.
        catalog_url: Of its catalog.
        job: Which was claimed.
        log_format: Of a process of its own.
        log_level: As well.
        memory_bytes: What the build may allocate, 0 for any amount; the process is its own, then.
        report: Takes the name of the error and what it says, if the catalog does not.

    Raises:
        TensorMapError: If how it ended cannot be written down, and nobody takes a report.
    """
    if parent_process() is not None:  # nobody's logging or memory but its own
        configure_logging(log_format, log_level)
        keep_freed_memory()
        private_files()
    _end_with_parent()
    one_blas_thread()
    try:
        _run(data_dir, catalog_url, job, memory_bytes)
    except TensorMapError as error:
        if report is None:
            raise
        report.send((type(error).__name__, str(error)))


def _run(data_dir: Path, catalog_url: str | None, job: JobRecord, memory_bytes: int) -> None:
    with (
        Store(data_dir, catalog_url) as store,
        suppress(JobNotFound),
    ):  # gone with its map
        progress = _JobProgress(store, job.id)
        try:
            with limited_memory(memory_bytes):
                plan = _plan(store, job)
                record = build_revision(store, job.map_id, plan, progress, job_id=job.id)
        except MemoryError as error:
            detail = f"the build needs more than the {memory_bytes} bytes that it may take: {error}"
            store.jobs.fail(job.id, BuildOutOfMemory.__name__, detail)
        except Cancelled:
            store.jobs.cancelled(job.id)
        except TensorMapError as error:
            store.jobs.fail(job.id, type(error).__name__, str(error))
        else:
            store.jobs.finish(job.id, record.digest)


def _plan(store: Store, job: JobRecord) -> Plan:
    """Return what was planned when the job was queued; an earlier version left it to the worker."""
    if job.plan is not None:
        return Plan.model_validate(job.plan)
    return plan_build(store, job.map_id, BuildParameters.model_validate(job.parameters))


class _JobProgress:
    """Writes progress into the catalog now and then, and stops the work when asked to."""

    def __init__(self, store: Store, job_id: str) -> None:
        self._store = store
        self._job_id = job_id
        self._stage, self._done, self._total = "", 0, 0
        self._reported_at = 0.0

    def start(self, stage: str, total: int) -> None:
        self._stage, self._done, self._total = stage, 0, total
        self._report()

    def advance(self, units: int = 1) -> None:
        self._done += units
        if self._done >= self._total or time.monotonic() - self._reported_at >= _REPORT_EVERY_S:
            self._report()

    def _report(self) -> None:
        self._reported_at = time.monotonic()
        job = self._store.jobs.progress(self._job_id, self._stage, self._done, self._total)
        if job.cancel_requested:
            raise Cancelled(f"job {self._job_id} was cancelled")


def _end_with_parent() -> None:
    """End this process when the service does, even if that was killed: the job is queued again."""
    parent = parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
