"""Captures in the catalog, on every database: their parts, their job, their end."""

from concurrent.futures import Future, ThreadPoolExecutor, wait
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any

import pytest

from core.errors import InvalidParameters
from storage.catalog import CaptureState, JobState, NewCapture, ended_captures
from storage.catalog import captures as module
from storage.catalog.models import Capture
from storage.catalog.pages import PAGE_CHARACTERS, all_items
from storage.errors import (
    CaptureNotFound,
    CaptureQueued,
    InvalidSlug,
    PartConflict,
    PartsMissing,
    TooManyBuilds,
    TooManyCaptures,
)
from storage.index_ranges import IndexRange
from tests.support.purges import purge_drive, purge_map

FILES = (("monday.bag", 90), ("metadata.yaml", 15))
DIGEST = "d" * 64


@pytest.fixture
def captures(catalog):
    catalog.maps.create("campus")
    return catalog.captures


def begin(captures, drive="monday", most_bytes=None, **other):
    return captures.create("campus", NewCapture(drive, FILES, 25, **other), most_bytes)[0]


def add(captures, capture, *numbers):
    for number in numbers:
        part = f"{number}.bin"
        captures.add_part("campus", capture.drive, capture.id, number, DIGEST, part)
    return captures.get("campus", capture.drive, capture.id)


def test_parts_are_counted_and_what_is_missing_is_named(captures):
    capture = begin(captures)
    assert (capture.parts, capture.size_of(4), capture.size_of(5)) == (5, 5, None)
    capture = add(captures, capture, 3, 0, 1)
    assert capture.received == (IndexRange(0, 1), IndexRange(3, 3))
    assert capture.missing == (IndexRange(2, 2), IndexRange(4, 4))
    with pytest.raises(PartsMissing, match="missing are 2, 4"):
        captures.complete("campus", "monday", capture.id)
    # A part that is there stays in its file, and other bytes are not taken for it.
    assert captures.add_part("campus", "monday", capture.id, 3, DIGEST, "x.bin")[1] == "3.bin"
    with pytest.raises(PartConflict, match=f"part 3 .* {'e' * 64}"):
        captures.add_part("campus", "monday", capture.id, 3, "e" * 64, "x.bin")
    [listed] = captures.list("campus").items
    assert listed.parts_received == capture.parts_received == 3
    assert captures.part("campus", "monday", capture.id, 3)[1] == (DIGEST, "3.bin")
    assert captures.part("campus", "monday", capture.id, 2)[1] is None
    captures.forget_parts([])
    captures.forget_parts([(capture.id, 3, "x.bin")])  # not the file that holds it now
    assert captures.part("campus", "monday", capture.id, 3)[1] == (DIGEST, "3.bin")
    captures.forget_parts([(capture.id, 3, "3.bin"), (capture.id, 0, "0.bin")])
    assert add(captures, capture, 0).missing == (IndexRange(2, 4),)
    with pytest.raises(InvalidSlug):
        begin(captures, "Monday")
    with pytest.raises(CaptureNotFound):
        captures.get("campus", "tuesday", capture.id)


def test_a_capture_is_not_found_in_a_drive_of_that_name_of_another_map(catalog, captures):
    capture = begin(captures)
    add(captures, capture, *range(5))
    catalog.maps.create("depot")
    where = ("depot", "monday", capture.id)
    for call in (
        lambda: captures.get(*where),
        lambda: captures.part(*where, 3),
        lambda: captures.add_part(*where, 3, DIGEST, "3.bin"),
        lambda: captures.complete(*where),
        lambda: captures.delete(*where),
    ):
        with pytest.raises(CaptureNotFound):
            call()
    assert captures.get("campus", "monday", capture.id).received == (IndexRange(0, 4),)


def test_the_same_content_is_one_capture_until_its_drive_is_gone(catalog, captures):
    first = begin(captures, digest=DIGEST)
    assert begin(captures, digest=DIGEST).id == first.id
    assert len({first.id, begin(captures).id, begin(captures, digest="e" * 64).id}) == 3
    assert begin(captures, digest=DIGEST, first_scan=9).id != first.id
    assert begin(captures, "tuesday", digest=DIGEST).id != first.id
    add(captures, first, *range(5))
    captures.complete("campus", "monday", first.id)
    job = catalog.jobs.claim()
    catalog.drives.put("campus", "monday", None, 1)
    catalog.jobs.finish(job.id, None)
    assert begin(captures, digest=DIGEST).state == CaptureState.DONE
    purge_drive(catalog, "campus", "monday")
    assert begin(captures, digest=DIGEST).state == CaptureState.RECEIVING


def test_a_capture_that_is_begun_again_has_the_new_topic_while_it_takes_parts(captures):
    first = begin(captures, digest=DIGEST, topic="/front")
    again = begin(captures, digest=DIGEST, topic="/rear")
    assert (again.id, again.topic) == (first.id, "/rear")
    assert captures.of_job(first.id).topic == "/rear"
    same = begin(captures, digest=DIGEST)  # it leaves the topic as it is
    assert (same.id, same.topic) == (first.id, "/rear")


def test_a_capture_with_another_topic_is_another_one_once_it_is_queued(catalog, captures):
    front = begin(captures, digest=DIGEST, topic="/front")
    add(captures, front, *range(5))
    captures.complete("campus", "monday", front.id)
    rear = begin(captures, digest=DIGEST, topic="/rear")
    assert rear.id != front.id
    job = catalog.jobs.claim()
    drive = catalog.drives.put("campus", "monday", None, 1)[0]
    catalog.jobs.finish(job.id, None, result={"drive_id": drive.id})
    done = begin(captures, digest=DIGEST, topic="/front")
    assert (done.id, done.state) == (front.id, CaptureState.DONE)
    assert begin(captures, digest=DIGEST, topic="/rear").id == rear.id
    captures.delete("campus", "monday", rear.id)
    assert begin(captures, digest=DIGEST).id == front.id
    assert captures.of_job(front.id).topic == "/front"


def test_a_capture_is_not_taken_as_read_into_another_drive_that_got_its_name(catalog, captures):
    older = catalog.drives.put("campus", "monday", None, 1)[0]
    entry = catalog.recycle_bin.put_drive("campus", "monday")
    capture = begin(captures, digest=DIGEST)
    add(captures, capture, *range(5))
    captures.complete("campus", "monday", capture.id)
    job = catalog.jobs.claim()
    read_into = catalog.drives.put("campus", "monday", None, 1)[0]
    catalog.jobs.finish(job.id, None, result={"drive_id": read_into.id})
    assert begin(captures, digest=DIGEST).state == CaptureState.DONE
    read = catalog.recycle_bin.put_drive("campus", "monday")
    assert catalog.recycle_bin.restore(entry.id).id == older.id  # made before it was read
    assert begin(captures, digest=DIGEST).state == CaptureState.RECEIVING
    catalog.recycle_bin.put_drive("campus", "monday")
    catalog.recycle_bin.restore(read.id)
    captures.delete("campus", "monday", begin(captures, digest=DIGEST).id)
    assert begin(captures, digest=DIGEST).id == capture.id


def test_a_keys_captures_are_limited_in_bytes_until_they_are_read(catalog, captures):
    limits = {"key_id": "k" * 32, "most_bytes": 209}
    first = begin(captures, **limits)
    with pytest.raises(TooManyCaptures, match=r"105 bytes of captures .* limit of 209"):
        begin(captures, **limits)
    begin(captures, key_id="l" * 32, most_bytes=209)
    add(captures, first, *range(5))
    with pytest.raises(TooManyBuilds):
        captures.complete("campus", "monday", first.id, most_queued=0)
    captures.complete("campus", "monday", first.id)
    catalog.jobs.finish(catalog.jobs.claim().id, None)
    begin(captures, **limits)


def test_a_page_follows_one_whose_last_capture_was_deleted(captures):
    ids = [begin(captures, drive).id for drive in ("a", "b", "c")]
    page = captures.list("campus", limit=1)
    assert [one.id for one in page.items] == ids[2:]
    captures.delete("campus", "c", ids[2])
    rest = captures.list("campus", None, page.next_after, 2)
    assert ([one.id for one in rest.items], rest.next_after) == ([ids[1], ids[0]], None)
    for cursor in (ids[0], "9" * 18 + "-a", "1-"):
        with pytest.raises(InvalidParameters, match="wanted `next_after`"):
            captures.list("campus", None, cursor)


def test_a_page_ends_early_where_its_captures_have_many_long_names(captures):
    files = tuple((f"{number:03}{'x' * 247}.db3", 1) for number in range(1000))
    capture_characters = 255 * len(files)
    most = PAGE_CHARACTERS // capture_characters
    count = 2 * most + 1
    ids = [captures.create("campus", NewCapture("monday", files, 25))[0].id for _ in range(count)]
    first = captures.list("campus", limit=1000)
    assert 0 < len(first.items) <= most
    pages = partial(captures.list, "campus", None, limit=1000)
    assert [one.id for one in all_items(pages)] == ids[::-1]


def test_captures_of_a_deleted_map_leave_the_quota_and_count_in_the_size_of_its_entry(
    catalog, captures
):
    limits = {"key_id": "k" * 32, "most_bytes": 105}
    capture = add(captures, begin(captures, **limits), 0, 4)  # of 25 and 5 bytes
    assert catalog.recycle_bin.put_map("campus").size_bytes == 30
    catalog.maps.create("dock")
    captures.create("dock", NewCapture("monday", FILES, 25, key_id="k" * 32), 105)
    catalog.recycle_bin.restore(capture.map_id)
    with pytest.raises(TooManyCaptures, match="210 bytes"):
        begin(captures, **limits)


def meanwhile(monkeypatch, name, call, module=module):
    """Let `call` begin in another thread before a module's function `name`; return its future."""
    function, threads = getattr(module, name), ThreadPoolExecutor()
    begun: list[Future[Any]] = []

    def hooked(*given, **named):
        if not begun:
            begun.append(threads.submit(call))
            wait(begun, 0.3)  # long enough, if nothing stops it
        return function(*given, **named)

    monkeypatch.setattr(module, name, hooked)
    return begun


def test_of_two_captures_begun_at_once_one_finds_the_other_or_has_no_room(captures, monkeypatch):
    limits = {"key_id": "k" * 32, "most_bytes": 209}
    same = meanwhile(monkeypatch, "same_capture", lambda: begin(captures, digest=DIGEST, **limits))
    first = begin(captures, digest=DIGEST, **limits)
    assert same[0].result().id == first.id
    captures.delete("campus", "monday", first.id)
    other = meanwhile(monkeypatch, "_require_room", lambda: begin(captures, "other", **limits))
    begin(captures, **limits)
    with pytest.raises(TooManyCaptures):
        other[0].result()


def test_a_capture_completed_while_its_map_is_deleted_leaves_no_open_job(
    catalog, captures, monkeypatch
):
    capture = add(captures, begin(captures), *range(5))
    deleted = meanwhile(monkeypatch, "queue_job", lambda: catalog.recycle_bin.put_map("campus"))
    captures.complete("campus", "monday", capture.id)
    entry = deleted[0].result()
    assert catalog.jobs.claim() is None
    assert not catalog.collector.has_open_job(entry.id)


def test_a_capture_that_is_deleted_while_it_is_begun_again_is_there_before_or_anew(
    captures, monkeypatch
):
    capture = begin(captures, digest=DIGEST, topic="/front")
    delete = partial(captures.delete, "campus", "monday", capture.id)
    deleted = meanwhile(monkeypatch, "capture_record", delete)
    again = begin(captures, digest=DIGEST, topic="/rear")
    assert deleted[0].result().id == capture.id
    assert (again.id, again.topic) == (capture.id, "/rear")
    assert begin(captures, digest=DIGEST, topic="/rear").id != capture.id


def test_a_capture_that_expires_is_not_completed_at_the_same_time(catalog, captures, monkeypatch):
    capture = add(captures, begin(captures), *range(5))
    complete = partial(captures.complete, "campus", "monday", capture.id)
    completed = meanwhile(monkeypatch, "_expiries", complete, ended_captures)
    later = datetime.now(UTC) + timedelta(seconds=9)
    assert captures.clear(later) == [(capture.map_id, capture.id)]
    with pytest.raises(CaptureNotFound):
        completed[0].result()
    assert catalog.jobs.claim() is None


def test_the_state_is_that_of_the_job_and_a_failed_one_is_queued_again(catalog, captures):
    capture = add(captures, begin(captures, topic="/front"), *range(5))
    job = captures.complete("campus", "monday", capture.id).job
    assert captures.complete("campus", "monday", capture.id).job.id == job.id
    with pytest.raises(CaptureQueued, match="is queued"):
        add(captures, capture, 0)
    assert catalog.jobs.claim().parameters == {"capture": capture.id, "drive": "monday"}
    catalog.jobs.fail(job.id, "MalformedDrive", "no such topic")
    failed = captures.of_job(capture.id)
    assert (failed.state, failed.missing, failed.takes_parts) == (CaptureState.FAILED, (), True)
    again = captures.complete("campus", "monday", capture.id, topic="/rear")
    assert (again.state, again.topic) == (CaptureState.QUEUED, "/rear")
    captures.delete("campus", "monday", capture.id)
    assert catalog.jobs.get(again.job.id).state == JobState.CANCELLED
    assert captures.list("campus").items == ()


def test_a_capture_whose_job_is_being_cancelled_is_not_completed_before_that_has_ended(
    catalog, captures
):
    capture = add(captures, begin(captures, topic="/front"), *range(5))
    captures.complete("campus", "monday", capture.id)
    job = catalog.jobs.claim()
    catalog.jobs.request_cancel(job.id)
    with pytest.raises(CaptureQueued, match=f"cancelled: complete it when job {job.id} has ended"):
        captures.complete("campus", "monday", capture.id, topic="/rear")
    assert captures.of_job(capture.id).topic == "/front"
    catalog.jobs.cancelled(job.id)
    again = captures.complete("campus", "monday", capture.id, topic="/rear")
    assert (again.state, again.topic) == (CaptureState.QUEUED, "/rear")


def test_what_was_read_or_expired_is_cleared_and_nothing_that_is_read(catalog, captures):
    now = datetime.now(UTC)
    before, later = now - timedelta(days=1), now + timedelta(days=1)
    read, open_, idle = (
        add(captures, begin(captures, drive), *range(5)) for drive in ("a", "b", "c")
    )
    for capture in (read, open_):
        captures.complete("campus", capture.drive, capture.id)
    catalog.jobs.finish(catalog.jobs.claim().id, None)
    map_id = read.map_id
    assert captures.clear(before) == [(map_id, read.id)]
    assert captures.clear(before) == []
    assert captures.of_job(read.id).missing == ()
    assert set(captures.clear(later)) == {(map_id, read.id), (map_id, idle.id)}
    assert captures.named_files() == {map_id: {open_.id: {f"{n}.bin": n for n in range(5)}}}
    [entry] = catalog.audit.list().items  # the one that nobody read
    assert (entry.key_id, entry.action, entry.map_slug) == ("service", "expire_capture", "campus")
    assert entry.subject == f"/v1/maps/campus/drives/c/captures/{idle.id}"
    assert entry.detail == "monday.bag, 5 parts"
    assert catalog.audit.verify().fault is None
    purge_map(catalog, "campus")


def test_a_capture_whose_reading_failed_lately_is_kept_though_its_parts_are_old(catalog, captures):
    now = datetime.now(UTC)
    before, later = now - timedelta(days=1), now + timedelta(days=1)
    capture = add(captures, begin(captures), *range(5))
    job = captures.complete("campus", "monday", capture.id).job
    with catalog._database.writing() as session:
        session.get_one(Capture, capture.id).touched_at = now - timedelta(days=9)
    assert captures.clear(later) == []  # it waits to be read
    catalog.jobs.fail(catalog.jobs.claim().id, "MalformedDrive", "no such topic")
    assert captures.clear(before) == []
    assert captures.of_job(capture.id).job.id == job.id
    assert captures.clear(later) == [(capture.map_id, capture.id)]


def test_captures_are_cleared_some_at_a_time_and_while_the_clock_is_wrong_only_read_ones(
    catalog, captures, monkeypatch
):
    monkeypatch.setattr(ended_captures, "_AT_ONCE", 2)
    later = datetime.now(UTC) + timedelta(days=1)
    read = [add(captures, begin(captures, "a"), *range(5)).id for _ in range(3)]
    idle = [begin(captures, "b").id for _ in range(5)]
    for capture_id in read:
        captures.complete("campus", "a", capture_id)
        catalog.jobs.finish(catalog.jobs.claim().id, None)
    cleared = [captures.clear(None) for _ in range(3)]
    assert [len(some) for some in cleared] == [2, 1, 0]
    assert {capture_id for some in cleared for _, capture_id in some} == {*read}
    cleared = [captures.clear(later) for _ in range(5)]
    assert [len(some) for some in cleared] == [2, 2, 2, 2, 0]
    assert {capture_id for some in cleared for _, capture_id in some} == {*read, *idle}
    assert len(catalog.audit.list().items) == len(idle)
