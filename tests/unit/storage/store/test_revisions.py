"""Revisions in the store, and starting a server on it."""

import errno
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from storage.catalog import JobState, RevisionFacts
from storage.errors import (
    CorruptFile,
    DataDirInUse,
    MapNotFound,
    RevisionIsLive,
    RevisionNotFound,
)
from storage.files.files import hidden_beside
from storage.files.map_file import map_of_bytes, write_map
from storage.store import Store
from tests.support.map_files import revision_file
from tests.support.samples import sample_map

FACTS = RevisionFacts(encoding="paper", scans=10, segments=2, parameters={})
A, B = "a" * 64, "b" * 64


def write(path):
    path.write_bytes(b"a map")


def files(store):
    return [path.name for path in store.layout.maps.rglob("*") if path.is_file()]


def test_a_revision_is_a_file_and_a_row(store):
    record = store.revisions.add(store.maps.get("campus").id, A, write, FACTS)
    path = revision_file(store, "campus", A[:12])
    assert path.read_bytes() == b"a map"
    assert path.name.startswith(A)
    assert record.size_bytes == 5
    assert store.revisions.live("campus") == record


def test_the_same_digest_again_keeps_the_first_file(store):
    first = store.revisions.add(store.maps.get("campus").id, A, write, FACTS)
    again = store.revisions.add(store.maps.get("campus").id, A, write, FACTS)
    assert (again.file_name, again.created_at) == (first.file_name, first.created_at)
    assert files(store) == [first.file_name]


def test_a_file_that_replaces_a_damaged_one_is_synced_in_its_place(store, monkeypatch):
    record = store.revisions.add(store.maps.get("campus").id, A, write, FACTS)
    path = store.revisions.path_of(record)
    path.write_bytes(b"damaged")
    synced = []
    monkeypatch.setattr(
        "storage.store.revisions.sync", lambda folder: synced.append((folder, path.read_bytes()))
    )
    store.revisions.add(record.map_id, A, write, FACTS)
    assert synced == [(path.parent, b"a map")]


def test_threads_that_add_the_same_revision_leave_one_file(store):
    with ThreadPoolExecutor(4) as pool:
        records = list(
            pool.map(
                lambda _: store.revisions.add(store.maps.get("campus").id, A, write, FACTS),
                range(8),
            )
        )
    assert len({record.file_name for record in records}) == 1
    assert files(store) == [records[0].file_name]


def test_a_revision_that_cannot_be_written_changes_nothing(store):
    def fail(path):
        path.write_bytes(b"half")
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        store.revisions.add(store.maps.get("campus").id, A, fail, FACTS)
    assert files(store) == []
    with pytest.raises(RevisionNotFound):
        store.revisions.get("campus", A)


def test_what_a_killed_process_wrote_of_a_revision_is_removed_while_no_other_is_written(store):
    map_id = store.maps.get("campus").id
    store.revisions.add(map_id, A, write, FACTS)
    left = hidden_beside(revision_file(store, "campus", A))
    left.write_bytes(b"half")

    def write_while_another_job_ends(path):
        write(path)
        store.revisions.remove_half_written(map_id)

    store.revisions.add(map_id, B, write_while_another_job_ends, FACTS)
    assert left.exists()
    store.revisions.remove_half_written(map_id)
    assert not left.exists()
    assert len(files(store)) == 2


def test_a_revision_of_a_map_that_is_deleted_meanwhile_leaves_no_file(store):
    def delete_first(path):
        write(path)
        store.maps.delete("campus")

    with pytest.raises(MapNotFound):
        store.revisions.add(store.maps.get("campus").id, A, delete_first, FACTS)
    assert files(store) == []


def test_a_deleted_revision_is_gone_and_the_live_one_stays(store):
    store.revisions.add(store.maps.get("campus").id, A, write, FACTS)
    store.revisions.add(store.maps.get("campus").id, B, write, FACTS)
    with pytest.raises(RevisionIsLive):
        store.revisions.delete("campus", A)
    store.revisions.delete("campus", B)
    assert len(files(store)) == 1
    assert revision_file(store, "campus", A).exists()


@pytest.mark.parametrize("read", ["read", "read_parameters"])
def test_a_revision_without_its_file_is_damaged_and_one_that_was_deleted_is_not_found(store, read):
    store.revisions.add(store.maps.get("campus").id, A, write, FACTS)
    record = store.revisions.add(store.maps.get("campus").id, B, write, FACTS)
    store.revisions.path_of(record).unlink()
    with pytest.raises(CorruptFile, match=f"the file of revision {B} is gone"):
        getattr(store.revisions, read)(record)
    store.revisions.delete("campus", B)
    with pytest.raises(RevisionNotFound):
        getattr(store.revisions, read)(record)


def test_an_opened_revision_is_read_to_its_end_though_it_is_deleted_meanwhile(store):
    made, _ = sample_map()
    map_id = store.maps.get("campus").id
    store.revisions.add(map_id, A, write, FACTS)
    store.revisions.add(map_id, made.revision, lambda path: write_map(path, made), FACTS)
    record, file = store.revisions.open("campus", made.revision[:12])
    with file:
        store.revisions.delete("campus", made.revision)
        assert record.digest == made.revision
        assert map_of_bytes(file.read(), "what was read").revision == made.revision


def test_a_damaged_revision_is_not_opened(store):
    store.revisions.add(store.maps.get("campus").id, A, write, FACTS)
    with pytest.raises(CorruptFile, match=A[:12]):
        store.revisions.open("campus", A)


@pytest.mark.parametrize("number", [errno.EIO, errno.EACCES])
def test_a_revision_whose_file_cannot_be_opened_is_damaged_and_the_reason_is_named(
    store, monkeypatch, number
):
    record = store.revisions.add(store.maps.get("campus").id, A, write, FACTS)

    def fail(path, *_arguments, **_options):
        raise OSError(number, os.strerror(number), str(path))

    monkeypatch.setattr(Path, "open", fail)
    with pytest.raises(CorruptFile, match=f"{A} cannot be read: {os.strerror(number)}$"):
        store.revisions.open("campus", record.digest)


def test_an_invalid_digest_is_rejected(store):
    with pytest.raises(ValueError, match="SHA-256"):
        store.revisions.add(store.maps.get("campus").id, "../x", write, FACTS)


def test_an_orphan_revision_is_swept(store):
    store.revisions.add(store.maps.get("campus").id, A, write, FACTS)
    revision_file(store, "campus", A).with_name(f"{B}.00000000.h5").write_bytes(b"orphan")
    store.recover()
    assert len(files(store)) == 1


def test_a_restart_queues_interrupted_jobs_again(tmp_path):
    with Store(tmp_path) as first:
        first.recover()
        first.maps.create("campus")
        job = first.jobs.create("campus", {})
        first.jobs.claim()
    with Store(tmp_path) as second:
        assert second.jobs.get(job.id).state is JobState.RUNNING
        second.recover()
        assert second.jobs.get(job.id).state is JobState.QUEUED


def test_one_data_directory_has_one_server_at_a_time(tmp_path):
    with Store(tmp_path) as first, Store(tmp_path) as second:
        first.recover()
        first.recover()
        with pytest.raises(DataDirInUse):
            second.recover()
        first.close()
        second.recover()
