"""Starts a process for each queued job, and makes sure that each one ends."""

import logging
import signal
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from multiprocessing.process import BaseProcess

from app.builds.stored_odometry import report_missing
from app.ending import KILLED_S, end
from app.http.errors import BuildStalled, CaptureTooSlow, WorkerDied
from app.http.logs import fields
from app.jobs.events import event_id
from app.jobs.worker import run_job
from app.outage import Outage
from app.process import most_build_memory_bytes
from app.settings import Settings
from core.errors import TensorMapError
from storage.catalog import CAPTURE, JobRecord, JobState
from storage.errors import JobNotFound, JobNotRunning, with_cause
from storage.files.forking import FORKER_KILLED, end_forked, forkserver, start_forked
from storage.store import Store

_POLL_S = 0.2
_LONGEST_POLL_S = 1.0  # one that takes longer was frozen, and mostly the worker with it
_CANCEL_GRACE_S = 0.8  # a worker checks for a cancel every 0.2 s, between two scans
_READ_GRACE_S = 30.0  # a worker says itself, after its start and a scan, how far it came in time
_MOST_CRASHES = 5  # a power cut is no reason to give up, nor are a few of them
_KILL_S = 10.0  # the longest that a killed process takes, unless its disk hangs

PRELOADED = "app.jobs.preloaded"
"""The module that the process that forks jobs has imported."""

_log = logging.getLogger("tensormap.jobs")


class JobRunner:
    """Runs queued builds, and readings of captures, `build_workers` at a time, one process each.

    A process rather than a thread: a job neither slows answers down nor can crash the service,
    and it can be ended at any point: a revision is published whole or not at all, and scans of a
    capture that are stored already are not stored again.

    Args:
        settings: The service's settings.
        store: The store with the queue.
        ended: Called with every job that has ended or was interrupted, unless its map was removed.
    """

    def __init__(
        self,
        settings: Settings,
        store: Store,
        *,
        ended: Callable[[JobRecord], None] = lambda _job: None,
    ) -> None:
        self._ended = ended
        # A job reads files of others, and needs no key.
        self._settings = settings.model_copy(update={"admin_key": None})
        self._store = store
        given = settings.build_memory_bytes
        own = most_build_memory_bytes(settings.build_workers)
        self._memory_bytes = own if given is None else given
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._begun: set[str] = set()  # ids of jobs that a thread has
        # Processes are forked from one that has loaded what jobs need, and nothing else.
        self._context = forkserver()
        self._context.set_forkserver_preload([PRELOADED])
        self._threads = [
            threading.Thread(target=self._loop, name=f"jobs-{i}", daemon=True)
            for i in range(settings.build_workers)
        ]

    def start(self) -> None:
        """Start with the queued jobs."""
        report_missing()
        for thread in self._threads:
            thread.start()

    @property
    def alive(self) -> bool:
        """Whether queued jobs are run."""
        return all(thread.is_alive() for thread in self._threads)

    def wake(self) -> None:
        """Read the queue now: a job was added."""
        self._wake.set()

    def stop(self) -> None:
        """End every running job, and queue it again for the next start of the service.

        Also one whose process cannot be started in this time: on a busy machine the process that
        forks takes seconds to load what jobs need.
        """
        self._stopping.set()
        self._wake.set()
        end(*self._threads)
        for job_id in tuple(self._begun):
            self._requeue(job_id)

    def _loop(self) -> None:
        claims, outage = _Claims(self._store), Outage(_log, "no job can be run now")
        while not self._stopping.is_set():
            try:
                found = self._run_next(claims)
            except Exception as error:  # noqa: BLE001 - jobs must run after any error
                outage.failed(error)
                found = False
            else:
                outage.over()
            if not found:
                self._wake.wait(_POLL_S * 5)
                self._wake.clear()

    def _run_next(self, claims: "_Claims") -> bool:
        """Run the next queued job to its end; return whether there was one."""
        job = claims.next()
        if job is None:
            return False
        self._begun.add(job.id)
        try:
            if job.crashes < _MOST_CRASHES:
                self._run(job)
            else:
                self._settle(job.id, WorkerDied.__name__, _given_up(job))
        except Exception as error:  # noqa: BLE001 - whatever it is, the job has ended
            _log.exception("job %s cannot be run", job.id)
            reason = f"it could not be run: {type(error).__name__}; see the log"
            if self._stopping.is_set():
                self._requeue(job.id)
            else:
                self._settle(job.id, WorkerDied.__name__, reason)
        self._begun.discard(job.id)
        self._report_end(job.id)
        return True

    def _run(self, job: JobRecord) -> None:
        reports, report = self._context.Pipe(duplex=False)

        def make() -> ForkServerProcess:
            return self._context.Process(
                target=run_job,
                args=(self._settings, job, self._memory_bytes, report),
                name=f"job-{job.id}",
            )

        with reports:
            with report:
                worker = self._start(make)
            try:
                stalled = self._watch(worker, job.id)
            finally:
                self._kill(worker)
            outcome = stalled or _reported(reports) or _death(worker)
            # First: it makes room for the outcome on a full disk, and after a crash the job, which
            # has not ended, runs again and leaves nothing.
            self._remove_half_written(job)
            if self._stopping.is_set():
                self._requeue(job.id)
            else:
                self._settle(job.id, *outcome)
        if worker.is_alive():
            _log.error("the process of job %s cannot be ended: the disk hangs", job.id)
        else:
            worker.close()

    def _remove_half_written(self, job: JobRecord) -> None:
        """Remove what a killed worker has written, if possible; else the map's next job does."""
        try:
            if job.kind == CAPTURE:
                self._store.captures.remove_abandoned(job.map_id, job.parameters["capture"])
            else:
                self._store.drives.remove_half_written_images(job.map_id)
                self._store.revisions.remove_half_written(job.map_id)
        except Exception:  # noqa: BLE001 - it must not hide why the job has ended
            _log.exception("what job %s left cannot be removed", job.id)

    def _report_end(self, job_id: str) -> None:
        try:
            job = self._store.jobs.get(job_id)
        except TensorMapError:  # removed with its map, or the catalog is unavailable
            return
        event = "job ended" if job.ended else "job interrupted, it is queued again at a start"
        logged = {
            "job": job.id,
            "map": job.map_slug,
            "kind": job.kind,
            "state": job.state.value,
            "error": job.error_type,
        }
        if job.state is JobState.FAILED:
            _log.warning(event, extra=fields(**logged, reason=job.error_detail))
        else:
            _log.info(event, extra=fields(**logged))
        self._ended(job)

    @staticmethod
    def _start(make: Callable[[], ForkServerProcess]) -> ForkServerProcess:
        """Start a worker that ignores the signals which stop the service.

        Ctrl-C and a service manager signal the whole group: the worker would end first, and its
        job would count as failed instead of being queued again. A process inherits the signals
        that the starting thread blocks; `kill` still ends it.
        """
        resource_tracker.ensure_running()  # which would unblock them if it were started later
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        try:
            return start_forked(make)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)

    def _watch(self, worker: BaseProcess, job_id: str) -> tuple[str, str] | None:
        """Wait for the worker's end; after a cancel, only for the time that it needs to notice.

        Time for which this process was frozen, as by `docker pause`, is none without progress.

        Returns:
            Why it is ended, if it makes no progress, or reads a capture for too long: it looks at
            the time between two scans, and no library does that opens one.
        """
        patience_s = _CANCEL_GRACE_S
        seen, without_s, ran_s, polled_s = "", 0.0, 0.0, time.monotonic()
        outage = Outage(_log, f"job {job_id} cannot be read")
        while worker.is_alive() and patience_s > 0 and not self._stopping.is_set():
            worker.join(_POLL_S)
            before_s, polled_s = polled_s, time.monotonic()
            passed_s = min(polled_s - before_s, _LONGEST_POLL_S)
            without_s, ran_s = without_s + passed_s, ran_s + passed_s
            try:
                job = self._store.jobs.get(job_id)
            except JobNotFound:  # removed with its map
                patience_s -= _POLL_S
                continue
            except TensorMapError as error:
                outage.failed(error)
                without_s = 0.0  # the worker cannot write its progress either
                continue
            outage.over()
            if job.cancel_requested:
                patience_s -= _POLL_S
            if (now := event_id(job)) != seen:
                seen, without_s = now, 0.0
            reached = f"stage {job.stage!r} after {job.done_units} of {job.total_units} units"
            stall_s, read_s = self._settings.build_stall_s, self._settings.capture_read_s
            if without_s > stall_s:
                reason = f"the {job.kind} made no progress for {stall_s:g} s, in {reached}"
                return BuildStalled.__name__, reason
            if job.kind == CAPTURE and ran_s > read_s + _READ_GRACE_S:
                reason = f"the capture was not read within {read_s:g} s, in {reached}"
                return CaptureTooSlow.__name__, reason
        return None

    def _kill(self, worker: ForkServerProcess) -> None:
        """Kill a worker and wait for its end; at a stop only so long that its job is queued again.

        Else the job would count a crash of the service.
        """
        end_forked(worker, KILLED_S)
        ends_at_s = time.monotonic() + _KILL_S - KILLED_S
        while worker.is_alive() and time.monotonic() < ends_at_s and not self._stopping.is_set():
            worker.join(_POLL_S)

    def _requeue(self, job_id: str) -> None:
        """Queue a job again that a stop interrupts, so that it does not count as a crash."""
        try:
            self._store.jobs.requeue(job_id)
        except (JobNotFound, JobNotRunning):
            pass  # removed with its map, or it ended before
        except TensorMapError as error:  # the next start queues it
            _log.warning("job %s cannot be queued again: %s", job_id, with_cause(error))

    def _settle(self, job_id: str, error: str, reason: str) -> None:
        """Store the outcome of a worker that could not do so itself.

        While the catalog is unavailable nothing else could be built either: this is retried.
        """
        outage = Outage(_log, f"the outcome of job {job_id} cannot be stored yet")
        while not self._stopping.is_set():
            try:
                self._store.jobs.fail(job_id, error, reason)
            except (JobNotFound, JobNotRunning):
                return  # removed with its map, or its outcome is stored
            except TensorMapError as failure:
                outage.failed(failure)
                self._stopping.wait(_POLL_S * 5)
            else:
                return


class _Claims:
    """Starts jobs for one thread; a job is not lost if the answer of the commit is."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._unanswered: datetime | None = None

    def next(self) -> JobRecord | None:
        """Start the next job, or return the one that was started without an answer."""
        if self._unanswered is not None:
            job = self._store.jobs.started_at(self._unanswered)
            self._unanswered = None
            if job is not None:
                return job
        self._unanswered = datetime.now(UTC)
        job = self._store.jobs.claim(self._unanswered)
        self._unanswered = None
        return job


def _reported(reports: Connection) -> tuple[str, str] | None:
    """Return the error that a worker could not store itself, `None` if it sent none."""
    try:
        found: tuple[str, str] | None = reports.recv() if reports.poll() else None
    except (EOFError, OSError):
        return None
    return found


def _given_up(job: JobRecord) -> str:
    return (
        f"while this job ran, the service ended without a stop {job.crashes} times, so it is not"
        " run again: if its memory or disk was the reason, request it again with more of these"
    )


def _death(worker: BaseProcess) -> tuple[str, str]:
    if worker.exitcode == FORKER_KILLED:
        reason = "the process that starts jobs was killed, and this one was ended: request it again"
        return WorkerDied.__name__, reason
    reason = f"the process ended with exit code {worker.exitcode}; see the log"
    if worker.exitcode == -signal.SIGKILL:
        reason += ", and the system's, which ends processes that take too much memory this way"
    return WorkerDied.__name__, reason
