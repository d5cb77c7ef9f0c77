"""Metrics for Prometheus. Every label has few values: never a map's name or an id."""

import math
import shutil
import threading
import time
from collections.abc import Callable
from functools import partial

import prometheus_client as prometheus

from core.confidence.decision import Refusal
from core.errors import TensorMapError
from core.tracking.step import Doubt
from storage.catalog import JobRecord, JobState
from storage.store import Store

_METHODS = frozenset({"DELETE", "GET", "HEAD", "OPTIONS", "PATCH", "POST", "PUT"})
_REQUEST_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0)
_BUILD_S = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1_000.0, 3_000.0, 10_000.0)
_LOCALIZED = "localized"
_OUTCOMES: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("scan", "image", "signature"), (_LOCALIZED, *Refusal)),
    "track": (_LOCALIZED, *Doubt),
}
"""The outcomes of each kind of query."""
_BYTES_KEPT_S = 30.0  # adding up a million scans takes the catalog some 0.1 s


class Metrics:
    """The metrics of one service; safe to share between threads."""

    def __init__(self) -> None:
        # The time at which each series began: as many lines as all counters have. All begin with
        # the service, and `process_start_time_seconds` says when.
        prometheus.disable_created_metrics()  # type: ignore[no-untyped-call]
        self._registry = registry = prometheus.CollectorRegistry()
        prometheus.ProcessCollector(registry=registry)
        counter: Callable[..., prometheus.Counter] = partial(prometheus.Counter, registry=registry)
        gauge: Callable[..., prometheus.Gauge] = partial(prometheus.Gauge, registry=registry)
        histogram: Callable[..., prometheus.Histogram] = partial(
            prometheus.Histogram, registry=registry
        )
        self._requests = counter(
            "tensormap_http_requests",
            "Requests that were answered, or whose client left before that: status 499.",
            ["route", "method", "status"],
        )
        self._request_s = histogram(
            "tensormap_http_request_seconds",
            "From a request's first byte to its answer's last one.",
            ["route", "method"],
            buckets=_REQUEST_S,
        )
        self._localizations = counter(
            "tensormap_localizations",
            "Answers to `where am I?`, by kind of query and outcome.",
            ["query", "outcome"],
        )
        for query, outcomes in _OUTCOMES.items():
            for outcome in outcomes:
                self._localizations.labels(query, outcome)  # from 0 on: a first one is a rise too
        self._builds = counter(
            "tensormap_builds", "Builds that ran, by their final state.", ["state"]
        )
        for state in (JobState.DONE, JobState.FAILED, JobState.CANCELLED):
            self._builds.labels(state.value)
        self._build_s = histogram(
            "tensormap_build_seconds",
            "From a build's start to its end.",
            ["state"],
            buckets=_BUILD_S,
        )
        self._jobs = gauge("tensormap_jobs", "Jobs that wait or run now.", ["state"])
        self._tracks = gauge("tensormap_tracks", "Tracks that are kept now.")
        self._store_bytes = gauge(
            "tensormap_store_bytes",
            "Stored bytes: raw returns, and files of revisions.",
            ["kind"],
        )
        self._free_bytes = gauge(
            "tensormap_disk_free_bytes",
            "What the data directory's file system has left, or that of maps/ if it has less; NaN"
            " if it cannot be read.",
        )
        self._catalog_up = gauge("tensormap_catalog_up", "1 if the catalog could be read just now.")
        self._scrubbed = counter(
            "tensormap_scrub_files",
            "Stored files that were read and checked in the background, by result.",
            ["result"],
        )
        for result in ("good", "damaged", "missing", "unreadable"):
            self._scrubbed.labels(result)
        self._scrub_damaged = gauge(
            "tensormap_scrub_damaged_files",
            "Stored files that the background check found damaged, missing or unreadable when it"
            " last read them, which it does hourly with such files; those that a request finds are"
            " counted at the next check.",
        )
        self._scrub_passed_s = gauge(
            "tensormap_scrub_last_pass_timestamp_seconds",
            "When all stored files had been checked last; before the first time, when that began;"
            " NaN if they are not checked.",
        )
        self._scrub_passed_s.set(math.nan)
        self._stored = counter(
            "tensormap_scans_stored",
            "Scans that were accepted and stored, without those that were stored before.",
        )
        self._lock = threading.Lock()
        self._expected: list[tuple[str, str, str]] = []
        self._added_up_at_s = -math.inf
        self._stored_scans = 0

    def expect(self, route: str, method: str, status: int) -> None:
        """Count an answer that no request has got yet from 0 on, so that the first one is a rise.

        Each takes 10 us: all of them are added when metrics are first rendered, not at the start.

        Args:
            route: The template of its path.
            method: The method.
            status: The answer's status.
        """
        self._expected.append((route, method, str(status)))

    def requested(self, route: str, method: str, status: int, seconds: float) -> None:
        """Count an answer.

        Args:
            route: The template of its path.
            method: The request's method; unknown ones are counted as one.
            status: The answer's status.
            seconds: The request's duration.
        """
        known = method if method in _METHODS else "OTHER"
        self._requests.labels(route, known, str(status)).inc()
        self._request_s.labels(route, known).observe(seconds)

    def localized(self, query: str, refusal: str | None) -> None:
        """Count an answer to a query: a place, or the reason why there is none."""
        self._localizations.labels(query, refusal or _LOCALIZED).inc()

    def built(self, job: JobRecord) -> None:
        """Count a build that ended; a running one is not counted."""
        if job.started_at is None or job.finished_at is None:
            return
        self._builds.labels(job.state.value).inc()
        seconds = (job.finished_at - job.started_at).total_seconds()
        self._build_s.labels(job.state.value).observe(max(seconds, 0.0))

    def stored(self, scans: int) -> None:
        """Count scans that the process of a job stored."""
        self._stored.inc(scans)

    def scrubbed(self, result: str) -> None:
        """Count a stored file that was checked: `good`, `damaged`, `missing` or `unreadable`."""
        self._scrubbed.labels(result).inc()

    def scrub_state(self, damaged: int, passed_at_s: float) -> None:
        """Set how many files are damaged, and when the last pass ended or the first one began."""
        self._scrub_damaged.set(damaged)
        self._scrub_passed_s.set(passed_at_s)

    def render(self, store: Store, tracks: int) -> bytes:
        """Return all metrics as text, those of the store as of now.

        If the catalog is unavailable its metrics keep their values, and `tensormap_catalog_up` is
        0: the other metrics are needed then more than ever, also where the whole data directory is
        gone.
        """
        with self._lock:
            self._read_store(store, tracks)
            for labels in self._expected:
                self._requests.labels(*labels)
            self._expected.clear()
            return prometheus.generate_latest(self._registry)

    def _read_store(self, store: Store, tracks: int) -> None:
        stored_scans = store.drives.stored_scans  # since the start, as the counter
        self._stored.inc(stored_scans - self._stored_scans)
        self._stored_scans = stored_scans
        self._tracks.set(tracks)
        self._free_bytes.set(_free_bytes(store))
        try:
            open_jobs = store.jobs.counts()
            for state in (JobState.QUEUED, JobState.RUNNING):
                self._jobs.labels(state.value).set(open_jobs.get(state, 0))
            now_s = time.monotonic()
            if now_s - self._added_up_at_s >= _BYTES_KEPT_S:
                for kind, size in store.stored_bytes().items():
                    self._store_bytes.labels(kind).set(size)
                self._added_up_at_s = now_s
        except TensorMapError:
            self._catalog_up.set(0)
        else:
            self._catalog_up.set(1)


def _free_bytes(store: Store) -> float:
    try:
        return min(shutil.disk_usage(folder).free for folder in store.layout.of_disks)
    except OSError:  # it is gone, or its disk fails
        return math.nan
