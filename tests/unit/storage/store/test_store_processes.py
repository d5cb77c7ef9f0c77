"""The store and other processes: killed ones, and workers beside the server."""

import itertools
import signal
from contextlib import suppress
from multiprocessing import Pipe, get_context

import pytest

from storage.catalog import JobState, RevisionFacts
from storage.store import Store
from tests.support.catalog_rows import stored_scans
from tests.support.small_scans import sample_scan

pytestmark = pytest.mark.slow

PROCESSES = get_context("forkserver")


def put_for_ever(data_dir, first, acknowledged):
    """Put scan after scan, and send the index of each that is stored."""
    with Store(data_dir) as store:
        for index in itertools.count(first):
            store.drives.put_scan("campus", "monday", index, sample_scan(index))
            acknowledged.send(index)


def put_until_killed(data_dir, first, acknowledgements):
    """Start a process that puts scans, kill it in the middle, return what it acknowledged."""
    received, sender = Pipe(duplex=False)
    process = PROCESSES.Process(target=put_for_ever, args=(data_dir, first, sender))
    process.start()
    sender.close()
    acknowledged = [received.recv() for _ in range(acknowledgements)]
    process.kill()
    with suppress(EOFError, OSError):  # nothing more, or half a message
        while True:
            acknowledged.append(received.recv())
    process.join()
    assert process.exitcode == -signal.SIGKILL
    return acknowledged


def test_what_a_killed_process_acknowledged_is_there_bit_for_bit(tmp_path):
    with Store(tmp_path) as store:
        store.maps.create("campus")
    acknowledged: list[int] = []
    for acknowledgements in (3, 20):
        acknowledged += put_until_killed(
            tmp_path,
            first=len(acknowledged) + 1_000 * acknowledgements,
            acknowledgements=acknowledgements,
        )
    with Store(tmp_path) as store:
        store.recover()
        present = [record.index for record in stored_scans(store, "campus", "monday")]
        assert set(acknowledged) <= set(present)
        for index in present:  # a row that was committed but not yet acknowledged is whole too
            scan = store.drives.read_scan("campus", "monday", index)
            assert scan.points_m.tobytes() == sample_scan(index).points_m.tobytes()
        names = [path.name for path in store.layout.maps.rglob("*.h5")]
        assert len(names) == len(present)


def work(data_dir, digest):
    """Build as a worker does: claim, report, add a revision, finish."""
    with Store(data_dir) as store:
        job = store.jobs.claim()
        assert job is not None
        for done in range(20):
            store.jobs.progress(job.id, "project", done, 20)
        facts = RevisionFacts("paper", 20, 1, {}, job_id=job.id)
        store.revisions.add(
            store.maps.get("campus").id, digest, lambda path: path.write_bytes(b"map"), facts
        )
        store.jobs.finish(job.id, digest)


def test_workers_in_other_processes_report_while_the_server_writes(tmp_path):
    digests = [character * 64 for character in "ab"]
    with Store(tmp_path) as store:
        store.recover()
        store.maps.create("campus")
        jobs = [store.jobs.create("campus", {}) for _ in digests]
        workers = [PROCESSES.Process(target=work, args=(tmp_path, digest)) for digest in digests]
        for worker in workers:
            worker.start()
        put = 0
        while any(worker.is_alive() for worker in workers):
            store.drives.put_scan("campus", "monday", put, sample_scan(put))
            put += 1
        for worker in workers:
            worker.join()
            assert worker.exitcode == 0
        assert [store.jobs.get(job.id).state for job in jobs] == [JobState.DONE] * 2
        assert {r.digest for r in store.revisions.list("campus").items} == set(digests)
        assert store.maps.get("campus").live_revision in digests
        assert store.drives.get("campus", "monday").scans == put
