"""What the catalog promises, on every database that it can stand on."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy.exc import IntegrityError

from core.errors import InvalidParameters
from core.pose import Pose
from storage.catalog import (
    Act,
    AuditCheck,
    AuditState,
    Catalog,
    IndexRange,
    JobState,
    RequestKey,
    RevisionFacts,
    ScanRecord,
    on_behalf,
)
from storage.catalog.audit import START
from storage.catalog.models import Base
from storage.catalog.scans import LostRace
from storage.errors import (
    AmbiguousRevision,
    DriveNotFound,
    InvalidSlug,
    JobNotFound,
    JobNotRunning,
    KeyNotFound,
    MapChanged,
    MapExists,
    MapNotFound,
    NoLiveRevision,
    RequestKeyReused,
    RevisionIsLive,
    RevisionNotFound,
    ScanNotFound,
)

FACTS = RevisionFacts(encoding="harmonic", scans=10, segments=2, parameters={"rank": [5, 5]})
A, B, C = "a" * 64, "b" * 64, "aaaaaaaaaaaa" + "c" * 52


@pytest.fixture
def catalog(database_url):
    opened = Catalog(database_url)
    yield opened
    opened.close()


def scan_record(index, chunk="one.h5", row=0, digest=A, pose=None, timestamp_s=math.nan):
    return ScanRecord(index, chunk, row, digest, 100, 3, timestamp_s, pose)


def add_scans(catalog, map_slug, drive_slug, indices, chunk="one.h5"):
    target = catalog.scans.target(map_slug, drive_slug, indices)
    catalog.scans.add(target, [scan_record(index, chunk, row) for row, index in enumerate(indices)])
    return target


class TestMaps:
    def test_a_map_is_there_once_made_and_gone_once_deleted(self, catalog):
        made = catalog.maps.create("campus", "north gate")
        assert catalog.maps.get("campus") == made
        assert (made.slug, made.description, made.version) == ("campus", "north gate", 1)
        assert made.live_revision is None
        assert made.created_at.tzinfo is UTC
        assert catalog.maps.delete("campus") == made
        with pytest.raises(MapNotFound, match="campus"):
            catalog.maps.get("campus")
        with pytest.raises(MapNotFound):
            catalog.maps.delete("campus")

    def test_no_two_maps_have_one_slug(self, catalog):
        catalog.maps.create("campus")
        catalog.maps.create("other")
        with pytest.raises(MapExists, match="campus"):
            catalog.maps.create("campus")
        with pytest.raises(MapExists):
            catalog.maps.update("other", new_slug="campus")

    def test_a_name_that_is_no_slug_is_refused(self, catalog):
        with pytest.raises(InvalidSlug):
            catalog.maps.create("../etc")
        catalog.maps.create("campus")
        with pytest.raises(InvalidSlug):
            catalog.maps.update("campus", new_slug="a/b")

    def test_a_map_made_again_has_another_id(self, catalog):
        first = catalog.maps.create("campus")
        catalog.maps.delete("campus")
        assert catalog.maps.create("campus").id != first.id

    def test_each_change_counts_the_version_up_and_no_change_does_not(self, catalog):
        catalog.maps.create("campus")
        assert catalog.maps.update("campus", description="new").version == 2
        assert catalog.maps.update("campus", description="new").version == 2
        renamed = catalog.maps.update("campus", new_slug="yard")
        assert (renamed.slug, renamed.version) == ("yard", 3)
        assert catalog.maps.get("yard") == renamed

    def test_a_change_of_another_version_is_refused(self, catalog):
        catalog.maps.create("campus")
        catalog.maps.update("campus", description="new", if_version=1)
        with pytest.raises(MapChanged, match="version 2, not 1"):
            catalog.maps.update("campus", description="late", if_version=1)
        with pytest.raises(MapChanged):
            catalog.maps.delete("campus", if_version=1)
        assert catalog.maps.get("campus").description == "new"

    def test_pages_together_are_the_whole_list_in_order(self, catalog):
        for slug in ("d", "a", "c", "b", "e"):
            catalog.maps.create(slug)
        seen, after, pages = [], "", 0
        while after is not None:
            page = catalog.maps.list(after, limit=2)
            seen += [record.slug for record in page.items]
            after, pages = page.next_after, pages + 1
        assert (seen, pages) == (["a", "b", "c", "d", "e"], 3)
        assert catalog.maps.list(limit=5).next_after is None

    def test_slugs_are_in_the_order_of_their_bytes(self, catalog):
        slugs = ["a-b", "a.a", "a0", "a_a", "aa", "ab"]
        assert slugs == sorted(slugs)
        for slug in reversed(slugs):
            catalog.maps.create(slug)
        assert [record.slug for record in catalog.maps.list().items] == slugs
        assert [record.slug for record in catalog.maps.list(after="a0").items] == slugs[3:]

    def test_of_many_that_make_one_map_at_once_one_does(self, catalog):
        def make(_):
            try:
                return catalog.maps.create("campus").id
            except MapExists:
                return None

        with ThreadPoolExecutor(6) as pool:
            made = [made_id for made_id in pool.map(make, range(12)) if made_id]
        assert made == [catalog.maps.get("campus").id]

    def test_a_name_with_a_nul_is_the_name_of_nothing(self, catalog):
        catalog.maps.create("campus")
        for name in ("\0", "campus\0"):
            with pytest.raises(MapNotFound):
                catalog.maps.get(name)
            with pytest.raises(DriveNotFound):
                catalog.drives.get("campus", name)
            with pytest.raises(JobNotFound):
                catalog.jobs.get(name)
            with pytest.raises(KeyNotFound):
                catalog.keys.get(name)
            with pytest.raises(RevisionNotFound):
                catalog.revisions.get("campus", name * 12)
            assert catalog.maps.list(after=name) is not None
        assert catalog.maps.update("campus", description="a\0b").description == "a\ufffdb"
        assert catalog.maps.get("campus").description == "a\ufffdb"

    def test_an_empty_page_is_refused(self, catalog):
        with pytest.raises(InvalidParameters):
            catalog.maps.list(limit=0)


class TestDrivesAndScans:
    def test_a_drive_is_made_by_its_first_scan(self, catalog):
        catalog.maps.create("campus")
        with pytest.raises(DriveNotFound, match="monday"):
            catalog.drives.get("campus", "monday")
        target = add_scans(catalog, "campus", "monday", [3])
        drive = catalog.drives.get("campus", "monday")
        assert drive.id == target.drive_id
        assert (drive.scans, drive.returns, drive.size_bytes, drive.closed) == (1, 100, 1200, False)

    def test_ranges_and_gaps_are_told(self, catalog):
        catalog.maps.create("campus")
        add_scans(catalog, "campus", "monday", [9, 2, 3, 0, 4, 8])
        drive = catalog.drives.get("campus", "monday")
        assert drive.present == (IndexRange(0, 0), IndexRange(2, 4), IndexRange(8, 9))
        assert drive.gaps == (IndexRange(1, 1), IndexRange(5, 7))
        assert (drive.first_index, drive.last_index, drive.scans) == (0, 9, 6)

    def test_drives_are_listed_by_slug_each_with_its_own_scans(self, catalog):
        catalog.maps.create("campus")
        catalog.maps.create("other")
        for slug, indices in {"b": [1], "a": [5, 7], "c": [0]}.items():
            add_scans(catalog, "campus", slug, indices)
        page = catalog.drives.list("campus", limit=2)
        assert [(drive.slug, drive.scans) for drive in page.items] == [("a", 2), ("b", 1)]
        rest = catalog.drives.list("campus", page.next_after)
        assert [drive.slug for drive in rest.items] == ["c"]
        assert catalog.drives.list("other").items == ()

    def test_facts_come_back_as_they_were_put(self, catalog):
        catalog.maps.create("campus")
        pose = Pose(1.5, -2.25, 0.1, 0.0, 0.0, 0.6, 0.8)
        record = scan_record(2**40, pose=pose, timestamp_s=1317617735.123456)
        target = catalog.scans.target("campus", "monday", [2**40])
        catalog.scans.add(target, [record])
        assert catalog.scans.of_drive(target.drive_id) == [record]
        assert catalog.scans.get(target.drive_id, 2**40) == record

    def test_an_unknown_timestamp_comes_back_unknown(self, catalog):
        catalog.maps.create("campus")
        target = add_scans(catalog, "campus", "monday", [0])
        assert math.isnan(catalog.scans.get(target.drive_id, 0).timestamp_s)
        assert catalog.scans.get(target.drive_id, 0).pose is None

    def test_a_target_tells_which_scans_are_there(self, catalog):
        catalog.maps.create("campus")
        add_scans(catalog, "campus", "monday", [1, 2, 3])
        target = catalog.scans.target("campus", "monday", [0, 2, 3])
        assert sorted(target.stored) == [2, 3]

    def test_adding_to_a_drive_that_changed_meanwhile_changes_nothing(self, catalog):
        catalog.maps.create("campus")
        before = catalog.scans.target("campus", "monday", [0])
        add_scans(catalog, "campus", "monday", [0])
        with pytest.raises(LostRace):  # the drive was made
            catalog.scans.add(before, [scan_record(0)])
        open_drive = catalog.scans.target("campus", "monday", [1, 2])
        add_scans(catalog, "campus", "monday", [2])
        with pytest.raises(LostRace):  # an index was taken
            catalog.scans.add(open_drive, [scan_record(1), scan_record(2)])
        catalog.drives.close("campus", "monday")
        with pytest.raises(LostRace):  # it was closed
            catalog.scans.add(open_drive, [scan_record(1)])
        catalog.drives.delete("campus", "monday")
        with pytest.raises(LostRace):  # it was removed
            catalog.scans.add(open_drive, [scan_record(1)])
        fresh = catalog.scans.target("campus", "tuesday", [1])
        catalog.maps.delete("campus")
        with pytest.raises(LostRace):  # the map was removed
            catalog.scans.add(fresh, [scan_record(1)])

    def test_closing_is_for_good_and_can_be_repeated(self, catalog):
        catalog.maps.create("campus")
        add_scans(catalog, "campus", "monday", [0])
        assert catalog.drives.close("campus", "monday").closed
        assert catalog.drives.close("campus", "monday").closed
        assert catalog.drives.get("campus", "monday").closed

    def test_poses_are_set_on_all_or_none(self, catalog):
        catalog.maps.create("campus")
        target = add_scans(catalog, "campus", "monday", [0, 1])
        pose = Pose(1.0, 2.0, 3.0)
        with pytest.raises(ScanNotFound, match=r"no scan 5 \(2 of 3 are missing\)"):
            catalog.scans.set_poses("campus", "monday", {0: pose, 5: pose}, {6: 1.0})
        assert catalog.scans.get(target.drive_id, 0).pose is None
        catalog.scans.set_poses("campus", "monday", {0: pose}, {1: 7.5})
        first, second = catalog.scans.of_drive(target.drive_id)
        assert (first.pose, second.pose, second.timestamp_s) == (pose, None, 7.5)
        catalog.scans.set_poses("campus", "monday", {0: None}, {})
        assert catalog.scans.get(target.drive_id, 0).pose is None

    def test_moved_scans_are_found_in_the_new_chunk(self, catalog):
        catalog.maps.create("campus")
        target = add_scans(catalog, "campus", "monday", [0, 1], "a.h5")
        add_scans(catalog, "campus", "monday", [2], "b.h5")
        records = catalog.scans.of_drive(target.drive_id)
        assert catalog.scans.move(target.drive_id, records[1:], "big.h5") == {"b.h5"}
        places = [(r.chunk, r.row) for r in catalog.scans.of_drive(target.drive_id)]
        assert places == [("a.h5", 0), ("big.h5", 0), ("big.h5", 1)]
        assert catalog.scans.chunks(target.drive_id) == {"a.h5", "big.h5"}
        with pytest.raises(LostRace):
            catalog.scans.move(target.drive_id, records[1:], "late.h5")

    def test_a_deleted_map_takes_all_it_had_with_it(self, catalog):
        catalog.maps.create("campus")
        target = add_scans(catalog, "campus", "monday", [0])
        catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, FACTS)
        job = catalog.jobs.create("campus", {})
        catalog.maps.delete("campus")
        assert catalog.scans.of_drive(target.drive_id) == []
        assert catalog.revisions.files(target.map_id) == set()
        assert catalog.drives.known() == set()
        with pytest.raises(JobNotFound):
            catalog.jobs.get(job.id)


class TestRevisions:
    @pytest.fixture(autouse=True)
    def campus(self, catalog):
        catalog.maps.create("campus")

    def test_the_first_revision_becomes_live_and_the_next_does_not(self, catalog):
        with pytest.raises(NoLiveRevision):
            catalog.revisions.live("campus")
        added = catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, FACTS)
        catalog.revisions.add(catalog.maps.get("campus").id, B, "b.h5", 10, FACTS)
        assert catalog.revisions.live("campus") == added
        assert catalog.maps.get("campus").live_revision == A
        assert (added.parameters, added.encoding) == ({"rank": [5, 5]}, "harmonic")

    def test_a_later_one_is_made_live_when_it_is_added_or_by_name(self, catalog):
        catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, FACTS)
        catalog.revisions.add(catalog.maps.get("campus").id, B, "b.h5", 10, FACTS, make_live=True)
        assert catalog.revisions.live("campus").digest == B
        assert catalog.maps.get("campus").version == 3
        catalog.revisions.set_live("campus", A[:12])
        assert catalog.revisions.live("campus").digest == A
        assert catalog.maps.get("campus").version == 4
        catalog.revisions.set_live("campus", A)
        assert catalog.maps.get("campus").version == 4

    def test_making_live_refuses_a_map_that_changed(self, catalog):
        catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, FACTS)
        with pytest.raises(MapChanged):
            catalog.revisions.set_live("campus", A, if_version=1)

    def test_the_same_digest_twice_keeps_the_first_record(self, catalog):
        first = catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, FACTS)
        assert (
            catalog.revisions.add(catalog.maps.get("campus").id, A, "again.h5", 10, FACTS) == first
        )
        assert len(catalog.revisions.list("campus").items) == 1

    def test_a_basis_names_the_live_revision_that_has_it_or_else_the_newest(self, catalog):
        map_id = catalog.maps.get("campus").id
        shared = replace(FACTS, bases=("1" * 64, "2" * 64))
        for digest in (A, B, C):
            catalog.revisions.add(map_id, digest, f"{digest}.h5", 10, shared)
        catalog.revisions.add(map_id, "d" * 64, "d.h5", 10, replace(FACTS, bases=("3" * 64,)))
        assert catalog.revisions.with_basis("campus", "2" * 64).digest == A
        catalog.revisions.set_live("campus", "d" * 64)
        assert catalog.revisions.with_basis("campus", "2" * 16).digest == C
        catalog.revisions.delete("campus", C)
        assert catalog.revisions.with_basis("campus", "1" * 64).digest == B
        for unknown in ("4" * 64, "1" * 11, "", "%" * 16, "_" * 16):
            assert catalog.revisions.with_basis("campus", unknown) is None
        catalog.maps.create("other")
        assert catalog.revisions.with_basis("other", "1" * 64) is None
        with pytest.raises(MapNotFound):
            catalog.revisions.with_basis("nowhere", "1" * 64)

    def test_bases_are_added_to_a_revision_from_before_they_were_written_down(self, catalog):
        map_id = catalog.maps.get("campus").id
        catalog.revisions.add(map_id, A, "a.h5", 10, FACTS)
        for _ in range(2):
            catalog.revisions.add(map_id, A, "a.h5", 10, replace(FACTS, bases=("1" * 64,)))
        assert catalog.revisions.with_basis("campus", "1" * 64).digest == A

    def test_a_job_keeps_the_notes_of_what_it_built(self, catalog):
        catalog.jobs.create("campus", {})
        job = catalog.jobs.claim()
        assert job.notes == ()
        facts = replace(FACTS, job_id=job.id, notes=("it fits badly",))
        catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, facts)
        done = catalog.jobs.get(job.id)
        assert (done.state, done.notes) == (JobState.DONE, ("it fits badly",))

    def test_a_revision_is_found_by_its_maps_id(self, catalog):
        map_id = catalog.maps.get("campus").id
        added = catalog.revisions.add(map_id, A, "a.h5", 10, FACTS)
        assert catalog.revisions.of_map(map_id, A[:12]) == added
        with pytest.raises(RevisionNotFound):
            catalog.revisions.of_map(map_id, B)
        catalog.maps.delete("campus")
        with pytest.raises(MapNotFound):
            catalog.revisions.of_map(map_id, A)

    def test_two_maps_may_have_the_same_revision(self, catalog):
        catalog.maps.create("other")
        one = catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, FACTS)
        two = catalog.revisions.add(catalog.maps.get("other").id, A, "a.h5", 10, FACTS)
        assert one.map_id != two.map_id

    def test_a_unique_prefix_of_twelve_digits_names_a_revision(self, catalog):
        for digest in (A, B):
            catalog.revisions.add(catalog.maps.get("campus").id, digest, "x.h5", 10, FACTS)
        assert catalog.revisions.get("campus", A[:12]).digest == A
        assert catalog.revisions.get("campus", A.upper()).digest == A
        for unknown in (A[:11], "", "%" * 12, "_" * 12, "c" * 12):
            with pytest.raises(RevisionNotFound):
                catalog.revisions.get("campus", unknown)
        catalog.revisions.add(catalog.maps.get("campus").id, C, "x.h5", 10, FACTS)
        with pytest.raises(AmbiguousRevision):
            catalog.revisions.get("campus", A[:12])
        assert catalog.revisions.get("campus", C[:13]).digest == C

    def test_the_live_revision_cannot_be_deleted(self, catalog):
        catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, FACTS)
        catalog.revisions.add(catalog.maps.get("campus").id, B, "b.h5", 10, FACTS)
        with pytest.raises(RevisionIsLive):
            catalog.revisions.delete("campus", A)
        assert catalog.revisions.delete("campus", B).file_name == "b.h5"
        with pytest.raises(RevisionNotFound):
            catalog.revisions.get("campus", B)

    def test_revisions_are_listed_newest_first_in_pages(self, catalog):
        digests = [f"{n:064x}" for n in (5, 3, 9, 1)]
        for digest in digests:
            catalog.revisions.add(catalog.maps.get("campus").id, digest, "x.h5", 10, FACTS)
        page = catalog.revisions.list("campus", limit=3)
        assert [r.digest for r in page.items] == digests[:0:-1]
        rest = catalog.revisions.list("campus", page.next_after, limit=3)
        assert ([r.digest for r in rest.items], rest.next_after) == (digests[:1], None)
        with pytest.raises(InvalidParameters):
            catalog.revisions.list("campus", after="f" * 64)

    def test_an_unknown_map_has_no_revisions(self, catalog):
        for ask in (catalog.revisions.list, catalog.revisions.live):
            with pytest.raises(MapNotFound):
                ask("nowhere")


class TestJobs:
    @pytest.fixture(autouse=True)
    def campus(self, catalog):
        catalog.maps.create("campus")

    def test_a_job_goes_from_the_queue_to_its_end(self, catalog):
        queued = catalog.jobs.create("campus", {"encoding": "paper"})
        assert (queued.state, queued.parameters) == (JobState.QUEUED, {"encoding": "paper"})
        running = catalog.jobs.claim()
        assert (running.id, running.state) == (queued.id, JobState.RUNNING)
        assert running.started_at >= queued.created_at
        halfway = catalog.jobs.progress(queued.id, "project", 50, 100)
        assert running.started_at <= halfway.stage_started_at <= datetime.now(UTC)
        assert catalog.jobs.get(queued.id) == halfway
        assert (halfway.stage, halfway.done_units, halfway.total_units) == ("project", 50, 100)
        done = catalog.jobs.finish(queued.id, A)
        assert (done.state, done.revision) == (JobState.DONE, A)
        assert done.finished_at >= running.started_at
        assert catalog.jobs.get(queued.id) == done

    def test_the_longest_waiting_job_is_claimed_and_each_once(self, catalog):
        made = [catalog.jobs.create("campus", {}).id for _ in range(12)]
        with ThreadPoolExecutor(4) as pool:
            claimed = list(pool.map(lambda _: catalog.jobs.claim(), range(14)))
        assert sorted(job.id for job in claimed if job) == sorted(made)
        assert claimed.count(None) == 2

    def test_a_request_makes_one_job_however_often_it_comes(self, catalog):
        request = RequestKey("retry-1", A)
        assert catalog.jobs.made_by("campus", request) is None
        with ThreadPoolExecutor(4) as pool:
            made = list(
                pool.map(lambda _: catalog.jobs.create("campus", {}, request=request), range(12))
            )
        assert len({job.id for job in made}) == 1
        assert [job.id for job in catalog.jobs.list().items] == [made[0].id]
        assert catalog.jobs.made_by("campus", request) == made[0]
        catalog.maps.create("dock")
        assert catalog.jobs.create("dock", {}, request=request).id != made[0].id

    def test_a_request_key_is_of_one_request(self, catalog):
        catalog.jobs.create("campus", {}, request=RequestKey("retry-1", A))
        for ask in (
            lambda: catalog.jobs.made_by("campus", RequestKey("retry-1", B)),
            lambda: catalog.jobs.create("campus", {}, request=RequestKey("retry-1", B)),
        ):
            with pytest.raises(RequestKeyReused, match="'retry-1'"):
                ask()
        assert len(catalog.jobs.list().items) == 1

    def test_a_job_of_a_map_that_is_being_deleted_is_queued_before_or_not_at_all(self, catalog):
        def queue(_):
            try:
                return catalog.jobs.create("campus", {}).id
            except MapNotFound:
                return None

        with ThreadPoolExecutor(4) as pool:
            queued = pool.map(queue, range(40))
            catalog.maps.delete("campus")
            made = [job for job in queued if job]
        assert catalog.jobs.list().items == ()
        for job in made:
            with pytest.raises(JobNotFound):
                catalog.jobs.get(job)

    def test_an_error_is_kept_with_its_type(self, catalog):
        catalog.jobs.create("campus", {})
        job = catalog.jobs.claim()
        failed = catalog.jobs.fail(job.id, "EmptyDrive", "drive 'monday' has no scan")
        assert (failed.state, failed.error_type) == (JobState.FAILED, "EmptyDrive")

    def test_only_a_running_job_makes_progress_or_ends(self, catalog):
        job = catalog.jobs.create("campus", {})
        for end in (
            lambda: catalog.jobs.progress(job.id, "x", 1, 2),
            lambda: catalog.jobs.finish(job.id, A),
            lambda: catalog.jobs.fail(job.id, "E", "e"),
            lambda: catalog.jobs.cancelled(job.id),
        ):
            with pytest.raises(JobNotRunning, match="queued"):
                end()
        with pytest.raises(JobNotFound):
            catalog.jobs.finish("0" * 32, A)

    def test_a_waiting_job_is_cancelled_a_running_one_asked_and_an_ended_one_left(self, catalog):
        running, waiting = catalog.jobs.create("campus", {}), catalog.jobs.create("campus", {})
        catalog.jobs.claim()
        assert catalog.jobs.request_cancel(waiting.id).state is JobState.CANCELLED
        assert catalog.jobs.claim() is None
        asked = catalog.jobs.request_cancel(running.id)
        assert (asked.state, asked.cancel_requested) == (JobState.RUNNING, True)
        assert catalog.jobs.progress(running.id, "x", 1, 2).cancel_requested
        ended = catalog.jobs.cancelled(running.id)
        assert ended.state is JobState.CANCELLED
        assert catalog.jobs.request_cancel(running.id) == ended

    def test_interrupted_jobs_wait_again_unless_they_were_to_stop(self, catalog):
        first, second, third = (catalog.jobs.create("campus", {}) for _ in range(3))
        catalog.jobs.claim()
        catalog.jobs.claim()
        catalog.jobs.progress(first.id, "project", 5, 9)
        catalog.jobs.request_cancel(second.id)
        assert catalog.jobs.requeue_interrupted() == 1
        assert catalog.jobs.get(first.id) == first
        assert catalog.jobs.get(second.id).state is JobState.CANCELLED
        assert catalog.jobs.get(third.id) == third

    def test_jobs_are_listed_newest_first_of_one_map_or_all(self, catalog):
        catalog.maps.create("other")
        ids = [catalog.jobs.create(slug, {}).id for slug in ("campus", "other", "campus")]
        page = catalog.jobs.list(limit=2)
        assert [job.id for job in page.items] == ids[:0:-1]
        assert [job.id for job in catalog.jobs.list(after=page.next_after).items] == ids[:1]
        assert [job.id for job in catalog.jobs.list("campus").items] == [ids[2], ids[0]]


class TestKeys:
    def test_a_key_is_kept_by_its_hash_until_it_is_revoked(self, catalog):
        key = catalog.keys.add("hash", ["write", "read", "read"])
        assert (key.secret_hash, key.scopes) == ("hash", ("read", "write"))
        assert catalog.keys.get(key.id) == key
        assert catalog.keys.with_hash("hash") == key
        assert catalog.keys.with_hash("other") is None
        assert catalog.keys.list().items == (key,)
        revoked = catalog.keys.revoke(key.id)
        assert revoked.revoked_at >= key.created_at
        assert catalog.keys.revoke(key.id) == revoked
        assert catalog.keys.ever_made()
        with pytest.raises(KeyNotFound):
            catalog.keys.get("0" * 32)

    def test_a_key_keeps_its_limits_and_opens_until_it_ends(self, catalog):
        assert not catalog.keys.ever_made()
        now = datetime.now(UTC)
        key = catalog.keys.add(
            "hash",
            ["localize"],
            key_id="ab12",
            name="fleet",
            maps=["campus", "airport", "campus"],
            expires_at=now + timedelta(hours=1),
        )
        assert catalog.keys.get("ab12") == key
        assert (key.name, key.maps, key.first_run) == ("fleet", ("airport", "campus"), False)
        assert key.opens_at(now)
        assert not key.opens_at(now + timedelta(hours=1))
        assert not catalog.keys.revoke("ab12").opens_at(now)
        with pytest.raises(IntegrityError):
            catalog.keys.add("hash", ["localize"])

    def test_keys_are_listed_a_page_at_a_time_in_the_order_of_their_making(self, catalog):
        ids = [catalog.keys.add(f"hash {i}", ["localize"]).id for i in range(3)]
        page = catalog.keys.list(limit=2)
        assert [key.id for key in page.items] == ids[:2]
        rest = catalog.keys.list(page.next_after)
        assert ([key.id for key in rest.items], rest.next_after) == (ids[2:], None)
        with pytest.raises(InvalidParameters):
            catalog.keys.list("0" * 32)


class TestTokens:
    def test_a_token_is_found_with_its_key_until_one_is_added_after_its_end(self, catalog):
        now = datetime.now(UTC)
        key = catalog.keys.add("key hash", ["localize"])
        hour = now + timedelta(hours=1)
        token = catalog.tokens.add("t1", "hash 1", "key hash", ["localize"], ["dock"], hour)
        assert (token.scopes, token.maps, token.expires_at) == (("localize",), ("dock",), hour)
        assert catalog.tokens.with_hash("hash 1") == (token, key)
        revoked = catalog.keys.revoke(key.id)
        assert catalog.tokens.with_hash("hash 1") == (token, revoked)
        ended = catalog.tokens.add("t2", "hash 2", "of the settings", ["localize"], None, now)
        assert catalog.tokens.with_hash("hash 2") == (ended, None)
        catalog.tokens.add("t3", "hash 3", "key hash", ["localize"], None, hour)
        assert catalog.tokens.with_hash("hash 2") is None
        assert catalog.tokens.with_hash("hash 1") is not None
        assert catalog.tokens.with_hash("key hash") is None


class TestLimitedLists:
    def test_maps_and_jobs_are_listed_of_the_named_maps_only(self, catalog):
        for slug in ("airport", "campus", "dock"):
            catalog.maps.create(slug)
        jobs = {slug: catalog.jobs.create(slug, {}).id for slug in ("campus", "dock")}
        some = ["dock", "airport", "nowhere"]
        first = catalog.maps.list(limit=1, slugs=some)
        assert [record.slug for record in first.items] == ["airport"]
        rest = catalog.maps.list(first.next_after, slugs=some)
        assert [record.slug for record in rest.items] == ["dock"]
        assert [job.id for job in catalog.jobs.list(slugs=some).items] == [jobs["dock"]]
        assert catalog.jobs.list("campus", slugs=some).items == ()
        assert catalog.maps.list(slugs=[]).items == ()


def changed_by(catalog, key_id, slug):
    """Make a map on behalf of a key."""
    with on_behalf(Act(key_id, "create_map", "/v1/maps", slug)):
        catalog.maps.create(slug)


def tamper(catalog, statement):
    with catalog._database.engine.begin() as connection:
        connection.exec_driver_sql(statement)


class TestAudit:
    def test_what_is_done_on_behalf_of_somebody_is_written_down_with_it(self, catalog):
        before = datetime.now(UTC)
        catalog.maps.create("nobodys")
        changed_by(catalog, "ab12", "campus")
        [entry] = catalog.audit.list().items
        told = (entry.seq, entry.key_id, entry.action, entry.subject, entry.map_slug, entry.outcome)
        assert told == (1, "ab12", "create_map", "/v1/maps", "campus", "done")
        assert before <= entry.at <= datetime.now(UTC)
        assert catalog.audit.state() == AuditState(1, entry.hash)

    def test_what_is_rolled_back_leaves_no_entry(self, catalog):
        changed_by(catalog, "ab12", "campus")
        with pytest.raises(MapExists):
            changed_by(catalog, "ab12", "campus")
        assert len(catalog.audit.list().items) == 1
        assert catalog.audit.verify().fault is None

    def test_one_act_is_one_entry_however_many_transactions_it_takes(self, catalog):
        with on_behalf(Act("ab12", "fill", "/v1")):
            catalog.maps.create("campus")
            catalog.maps.create("dock")
        assert len(catalog.audit.list().items) == 1

    def test_a_refusal_is_added_by_itself(self, catalog):
        act = Act("ab12", "delete_map", "/v1/maps/campus", "campus")
        with on_behalf(act):
            catalog.audit.append(act, "403")
        assert [entry.outcome for entry in catalog.audit.list().items] == ["403"]

    def test_entries_are_found_by_map_key_and_time_a_page_at_a_time(self, catalog):
        for key, slug in (("a", "one"), ("b", "two"), ("a", "three"), ("a", "four")):
            changed_by(catalog, key, slug)
        every = catalog.audit.list().items
        assert [entry.seq for entry in every] == [1, 2, 3, 4]
        first = catalog.audit.list(limit=2, key_id="a")
        assert [entry.map_slug for entry in first.items] == ["one", "three"]
        rest = catalog.audit.list(int(first.next_after), 2, key_id="a")
        assert ([entry.map_slug for entry in rest.items], rest.next_after) == (["four"], None)
        assert [entry.seq for entry in catalog.audit.list(map_slug="two").items] == [2]
        assert catalog.audit.list(map_slug="nowhere").items == ()
        assert catalog.audit.list(since=every[2].at).items[-2:] == every[2:]
        assert every[2] not in catalog.audit.list(until=every[2].at).items

    def test_a_whole_log_is_good_and_its_states_are_known_again(self, catalog):
        states = [catalog.audit.state()]
        assert catalog.audit.verify(states[0]) == AuditCheck(START, None)
        for slug in ("one", "two", "three"):
            changed_by(catalog, "ab12", slug)
            states.append(catalog.audit.state())
        for known in states:
            assert catalog.audit.verify(known) == AuditCheck(states[-1], None)

    @pytest.mark.parametrize(
        ("statement", "good", "fault"),
        [
            ("UPDATE audit SET key_id = 'other' WHERE seq = 3", 2, "3 is not what was written"),
            ("UPDATE audit SET outcome = '403' WHERE seq = 1", 0, "1 is not what was written"),
            ("UPDATE audit SET map_slug = NULL WHERE seq = 5", 4, "5 is not what was written"),
            ("UPDATE audit SET at = '2020-01-01 00:00:00' WHERE seq = 2", 1, "2 is not what was"),
            ("DELETE FROM audit WHERE seq = 3", 2, "3 is gone"),
            ("DELETE FROM audit WHERE seq = 1", 0, "1 is gone"),
            ("DELETE FROM audit WHERE seq = 5", 4, "had 5 entries, 4 are left"),
            ("UPDATE audit SET seq = 9 WHERE seq = 2", 1, "2 is gone; 3 follows"),
            ("DELETE FROM audit", 0, "had 5 entries, 0 are left"),
            ("UPDATE audit SET seq = 9 WHERE seq = 5", 4, "had 5 entries, 4 are left"),
        ],
    )
    def test_a_changed_or_removed_entry_is_found(self, catalog, statement, good, fault):
        for number in range(5):
            changed_by(catalog, "ab12", f"map-{number}")
        tamper(catalog, statement)
        found = catalog.audit.verify()
        assert found.state.seq == good
        assert fault in found.fault

    def test_a_log_that_was_written_anew_is_known_by_a_state_kept_elsewhere(self, catalog):
        for slug in ("one", "two", "three"):
            changed_by(catalog, "ab12", slug)
        known = catalog.audit.state()
        tamper(catalog, "DELETE FROM audit")
        tamper(catalog, f"UPDATE audit_head SET seq = 0, hash = '{START.hash}'")
        for slug in ("new-one", "new-two"):
            changed_by(catalog, "ab12", slug)
        assert catalog.audit.verify().fault is None
        assert "was known, 2 are left" in catalog.audit.verify(known).fault
        changed_by(catalog, "ab12", "new-three")
        assert "3 is not the one that was known" in catalog.audit.verify(known).fault

    def test_changes_at_once_make_one_chain(self, catalog):
        with ThreadPoolExecutor(8) as pool:
            slugs = [f"map-{number}" for number in range(24)]
            list(pool.map(lambda slug: changed_by(catalog, "ab12", slug), slugs))
        assert catalog.audit.verify() == AuditCheck(catalog.audit.state(), None)
        assert {entry.map_slug for entry in catalog.audit.list().items} == set(slugs)

    def test_a_state_is_a_number_and_a_hash(self):
        for seq, digest in ((-1, "0" * 64), (3, "0" * 63)):
            with pytest.raises(InvalidParameters):
                AuditState(seq, digest)


class TestOpening:
    def test_what_was_committed_is_there_when_it_is_opened_again(self, database_url):
        first = Catalog(database_url)
        made = first.maps.create("campus")
        first.close()
        second = Catalog(database_url)
        assert second.maps.get("campus") == made
        second.close()

    def test_two_open_catalogs_see_each_others_commits(self, database_url, catalog):
        other = Catalog(database_url)
        catalog.maps.create("campus")
        assert other.maps.update("campus", description="new").version == 2
        assert catalog.maps.get("campus").description == "new"
        other.close()

    def test_many_can_open_a_new_catalog_at_once(self, database_url):
        with ThreadPoolExecutor(6) as pool:
            catalogs = list(pool.map(Catalog, [database_url] * 6))
        for number, catalog in enumerate(catalogs):
            catalog.maps.create(f"map-{number}")
            catalog.close()

    def test_a_store_is_given_one_id_by_whoever_asks_first(self, database_url, catalog):
        other = Catalog(database_url)
        ids = iter("abcdefgh")
        with ThreadPoolExecutor(4) as pool:
            asked = [
                pool.submit(c.store_id.ensure, lambda: next(ids)) for c in [catalog, other] * 4
            ]
        assert {future.result() for future in asked} == {"a"}
        assert next(ids) == "b"
        other.close()

    def test_the_schema_is_what_the_models_say(self, catalog):
        with catalog._database.engine.connect() as connection:
            context = MigrationContext.configure(connection, opts={"compare_server_default": True})
            assert compare_metadata(context, Base.metadata) == []

    def test_an_error_rolls_everything_back(self, catalog):
        catalog.maps.create("campus")
        target = catalog.scans.target("campus", "monday", [0])
        with pytest.raises(LostRace):
            catalog.scans.add(target, [scan_record(0), scan_record(0)])
        with pytest.raises(DriveNotFound):
            catalog.drives.get("campus", "monday")
