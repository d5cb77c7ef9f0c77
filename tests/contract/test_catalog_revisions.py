"""What the catalog promises of revisions and of the jobs that build them."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from core.errors import InvalidParameters
from storage.catalog import (
    IdempotencyKey,
    JobState,
)
from storage.errors import (
    AmbiguousRevision,
    JobNotFound,
    JobNotRunning,
    LostRace,
    MapChanged,
    MapNotFound,
    NoLiveRevision,
    RequestKeyReused,
    RevisionIsLive,
    RevisionNotFound,
    TooManyBuilds,
)
from storage.retention import Retention
from tests.support.catalog_rows import FACTS, A, B, C


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

    def test_revisions_stay_in_order_when_the_clock_is_set_back(self, catalog, monkeypatch):
        class SetBack(datetime):
            @classmethod
            def now(cls, tz=None):
                return next(times)

        now = datetime.now(UTC)
        times = (now - timedelta(hours=hours) for hours in range(1, 1000))
        monkeypatch.setattr("storage.catalog.revisions.datetime", SetBack)
        campus, basis = catalog.maps.get("campus").id, "e" * 64
        for digest, name in ((A, "a.h5"), (C, "c.h5"), (B, "b.h5")):
            bases = () if digest == A else (basis,)
            catalog.revisions.add(campus, digest, name, 10, replace(FACTS, bases=bases))
        first = catalog.revisions.list("campus", limit=2)
        assert [item.digest for item in first.items] == [B, C]
        rest = catalog.revisions.list("campus", first.next_after)
        assert [item.digest for item in rest.items] == [A]
        assert catalog.revisions.with_basis("campus", basis).digest == B
        keeps_none = Retention(retained_revisions=0, retained_for_days=0.0)
        assert catalog.collector.collectable(campus, keeps_none) == (C,)

    def test_one_is_found_in_its_own_map_only(self, catalog):
        campus, depot = catalog.maps.get("campus").id, catalog.maps.create("depot").id
        catalog.revisions.add(campus, A, "a.h5", 10, FACTS)
        catalog.revisions.add(campus, B, "b.h5", 10, FACTS)
        for find in (catalog.revisions.get, catalog.revisions.set_live, catalog.revisions.delete):
            for digest in (B, B[:12]):
                with pytest.raises(RevisionNotFound):
                    find("depot", digest)
        catalog.revisions.add(depot, B, "b.h5", 10, FACTS)
        assert catalog.revisions.get("depot", B[:12]).map_id == depot
        assert catalog.revisions.get("campus", B[:12]).map_id == campus

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

    def test_one_is_added_only_if_that_is_live_which_it_was_compared_with(self, catalog):
        campus = catalog.maps.get("campus").id
        with pytest.raises(LostRace):
            catalog.revisions.add(campus, A, "a.h5", 10, FACTS, make_live=True, if_live=B)
        catalog.revisions.add(campus, A, "a.h5", 10, FACTS, make_live=True, if_live="")
        for other in ("", B):
            with pytest.raises(LostRace, match="became live meanwhile"):
                catalog.revisions.add(campus, C, "c.h5", 10, FACTS, make_live=True, if_live=other)
        assert [item.digest for item in catalog.revisions.list("campus").items] == [A]
        catalog.revisions.add(campus, C, "c.h5", 10, FACTS, make_live=True, if_live=A)
        assert catalog.revisions.live("campus").digest == C

    def test_making_live_rejects_a_map_that_changed(self, catalog):
        catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, FACTS)
        with pytest.raises(MapChanged):
            catalog.revisions.set_live("campus", A, if_versions=(1,))

    def test_the_same_digest_twice_keeps_the_first_record(self, catalog):
        first = catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, FACTS)
        again = catalog.revisions.add(catalog.maps.get("campus").id, A, "again.h5", 10, FACTS)
        assert again.retained_from > first.retained_from
        assert (again.file_name, again.created_at) == ("a.h5", first.created_at)
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
        assert job.notes == []
        facts = replace(FACTS, job_id=job.id, notes=("it fits badly",))
        catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, facts)
        done = catalog.jobs.get(job.id)
        assert (done.state, done.notes) == (JobState.DONE, ["it fits badly"])

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

    def test_a_shorter_prefix_is_refused_with_how_long_it_must_be(self, catalog):
        catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, FACTS)
        for short in (A[:4], A[:11], ""):
            with pytest.raises(RevisionNotFound, match="at least its 12 first digits"):
                catalog.revisions.get("campus", short)
        with pytest.raises(RevisionNotFound, match=r"has no revision 'cccccccccccc'$"):
            catalog.revisions.get("campus", "c" * 12)

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
        for call in (catalog.revisions.list, catalog.revisions.live):
            with pytest.raises(MapNotFound):
                call("nowhere")


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

    @pytest.mark.parametrize("next_drive", [(0, 100), (0, 80), (40, 100), (100, 120)])
    def test_a_stage_that_begins_again_with_the_next_drive_has_a_pace_of_its_own(
        self, catalog, next_drive
    ):
        job = catalog.jobs.create("campus", {})
        catalog.jobs.claim()
        begun = catalog.jobs.progress(job.id, "projecting", 50, 100).stage_started_at
        ended = catalog.jobs.progress(job.id, "projecting", 100, 100)
        assert ended.stage_started_at == begun
        again = catalog.jobs.progress(job.id, "projecting", *next_drive)
        assert again.stage_started_at > begun

    def test_the_longest_waiting_job_is_claimed_and_each_once(self, catalog):
        made = [catalog.jobs.create("campus", {}).id for _ in range(12)]
        with ThreadPoolExecutor(4) as pool:
            claimed = list(pool.map(lambda _: catalog.jobs.claim(), range(14)))
        assert sorted(job.id for job in claimed if job) == sorted(made)
        assert claimed.count(None) == 2

    def test_keys_take_turns_whoever_queued_first(self, catalog):
        greedy = [catalog.jobs.create("campus", {}, key_id="greedy").id for _ in range(4)]
        other = [catalog.jobs.create("campus", {}, key_id="other").id for _ in range(2)]
        [nobody] = [catalog.jobs.create("campus", {}).id]
        claimed = []
        while (job := catalog.jobs.claim()) is not None:
            claimed.append(job.id)
            catalog.jobs.fail(job.id, "EmptyDrive", "no scan")
        assert claimed == [greedy[0], other[0], nobody, greedy[1], other[1], *greedy[2:]]

    def test_a_key_with_a_running_job_waits_for_one_that_has_none(self, catalog):
        for key in ("greedy", "greedy", "other", "other"):
            catalog.jobs.create("campus", {}, key_id=key)
        first, second = catalog.jobs.claim(), catalog.jobs.claim()
        assert (first.key_id, second.key_id) == ("greedy", "other")
        catalog.jobs.fail(second.id, "EmptyDrive", "no scan")
        assert catalog.jobs.claim().key_id == "other"  # though it was its turn just now

    def test_the_maps_of_a_key_take_turns_too(self, catalog):
        catalog.maps.create("dock")
        slugs = {catalog.maps.get(slug).id: slug for slug in ("campus", "dock")}
        for slug in ("campus", "campus", "campus", "dock", "dock"):
            catalog.jobs.create(slug, {}, key_id="one")
        claimed = [slugs[catalog.jobs.claim().map_id] for _ in range(5)]
        assert claimed == ["campus", "dock", "campus", "dock", "campus"]

    def test_a_key_queues_as_many_builds_as_it_may_and_others_still_can(self, catalog):
        for _ in range(3):
            catalog.jobs.create("campus", {}, key_id="greedy", most_queued=3)
        with pytest.raises(TooManyBuilds, match="greedy has reached the limit of 3 queued jobs"):
            catalog.jobs.create("campus", {}, key_id="greedy", most_queued=3)
        catalog.jobs.create("campus", {}, key_id="other", most_queued=3)
        running = catalog.jobs.claim()
        assert running.key_id == "greedy"  # what runs is no longer in the queue
        catalog.jobs.create("campus", {}, key_id="greedy", most_queued=3)

    def test_a_repeated_request_is_answered_even_when_the_queue_is_full(self, catalog):
        key = IdempotencyKey("retry-1", A)
        made = catalog.jobs.create("campus", {}, idempotency_key=key, key_id="a", most_queued=1)
        again = catalog.jobs.create("campus", {}, idempotency_key=key, key_id="a", most_queued=1)
        assert again == made

    def test_a_request_of_another_map_with_the_same_key_makes_a_job_of_its_own(self, catalog):
        catalog.maps.create("dock")
        first = catalog.jobs.create("campus", {}, idempotency_key=IdempotencyKey("retry-1", A))
        assert catalog.jobs.made_by("dock", IdempotencyKey("retry-1", A)) is None
        second = catalog.jobs.create("dock", {}, idempotency_key=IdempotencyKey("retry-1", B))
        assert catalog.jobs.made_by("campus", IdempotencyKey("retry-1", A)).id == first.id
        assert catalog.jobs.made_by("dock", IdempotencyKey("retry-1", B)).id == second.id

    def test_a_job_is_done_with_one_revision(self, catalog):
        catalog.jobs.create("campus", {})
        job = catalog.jobs.claim()
        done = catalog.jobs.finish(job.id, A)
        assert catalog.jobs.finish(job.id, A) == done
        with pytest.raises(JobNotRunning):
            catalog.jobs.finish(job.id, B)
        assert catalog.jobs.get(job.id).revision == A

    def test_a_repeated_request_makes_one_job(self, catalog):
        key = IdempotencyKey("retry-1", A)
        assert catalog.jobs.made_by("campus", key) is None
        with ThreadPoolExecutor(4) as pool:
            made = list(
                pool.map(
                    lambda _: catalog.jobs.create("campus", {}, idempotency_key=key), range(12)
                )
            )
        assert len({job.id for job in made}) == 1
        assert [job.id for job in catalog.jobs.list().items] == [made[0].id]
        assert catalog.jobs.made_by("campus", key) == made[0]
        catalog.maps.create("dock")
        assert catalog.jobs.create("dock", {}, idempotency_key=key).id != made[0].id

    def test_an_idempotency_key_is_of_one_request(self, catalog):
        catalog.jobs.create("campus", {}, idempotency_key=IdempotencyKey("retry-1", A))
        for call in (
            lambda: catalog.jobs.made_by("campus", IdempotencyKey("retry-1", B)),
            lambda: catalog.jobs.create("campus", {}, idempotency_key=IdempotencyKey("retry-1", B)),
        ):
            with pytest.raises(RequestKeyReused, match="'retry-1'"):
                call()
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

    def test_cancelling_ends_a_queued_job_and_requests_the_end_of_a_running_one(self, catalog):
        running, waiting = catalog.jobs.create("campus", {}), catalog.jobs.create("campus", {})
        catalog.jobs.claim()
        assert catalog.jobs.request_cancel(waiting.id).state is JobState.CANCELLED
        assert catalog.jobs.claim() is None
        cancelling = catalog.jobs.request_cancel(running.id)
        assert (cancelling.state, cancelling.cancel_requested) == (JobState.RUNNING, True)
        assert catalog.jobs.progress(running.id, "x", 1, 2).cancel_requested
        ended = catalog.jobs.cancelled(running.id)
        assert ended.state is JobState.CANCELLED
        assert catalog.jobs.request_cancel(running.id) == ended

    def test_who_started_a_job_finds_it_by_the_time_while_it_runs(self, catalog):
        first, second = (catalog.jobs.create("campus", {}) for _ in range(2))
        at = datetime.now(UTC)
        assert catalog.jobs.started_at(at) is None
        catalog.jobs.claim(at)
        catalog.jobs.claim(at + timedelta(microseconds=1))
        found = catalog.jobs.started_at(at)
        assert found is not None
        assert (found.id, found.started_at, found.map_slug) == (first.id, at, "campus")
        catalog.jobs.fail(first.id, "Odd", "")
        assert catalog.jobs.started_at(at) is None
        assert catalog.jobs.get(second.id).state is JobState.RUNNING

    def test_interrupted_jobs_wait_again_unless_they_were_to_stop(self, catalog):
        first, second, third = (catalog.jobs.create("campus", {}) for _ in range(3))
        catalog.jobs.claim()
        catalog.jobs.claim()
        catalog.jobs.progress(first.id, "project", 5, 9)
        catalog.jobs.request_cancel(second.id)
        assert catalog.jobs.requeue_interrupted() == 1
        first.crashes = 1
        assert catalog.jobs.get(first.id) == first
        assert catalog.jobs.get(second.id).state is JobState.CANCELLED
        assert catalog.jobs.get(third.id) == third

    def test_only_a_job_that_no_stop_interrupted_counts_a_crash(self, catalog):
        job = catalog.jobs.create("campus", {})
        with pytest.raises(JobNotRunning):
            catalog.jobs.requeue(job.id)
        for crashes in (1, 2):
            catalog.jobs.claim()
            catalog.jobs.progress(job.id, "project", 5, 9)
            waiting = catalog.jobs.requeue(job.id)
            assert (waiting.state, waiting.started_at) == (JobState.QUEUED, None)
            assert catalog.jobs.claim().id == job.id
            catalog.jobs.requeue_interrupted()
            assert catalog.jobs.get(job.id).crashes == crashes
        catalog.jobs.claim()
        catalog.jobs.request_cancel(job.id)
        assert catalog.jobs.requeue(job.id).state is JobState.CANCELLED

    def test_jobs_are_listed_newest_first_of_one_map_or_all(self, catalog):
        catalog.maps.create("other")
        ids = [catalog.jobs.create(slug, {}).id for slug in ("campus", "other", "campus")]
        page = catalog.jobs.list(limit=2)
        assert [job.id for job in page.items] == ids[:0:-1]
        assert [job.id for job in catalog.jobs.list(after=page.next_after).items] == ids[:1]
        assert [job.id for job in catalog.jobs.list("campus").items] == [ids[2], ids[0]]

    def test_jobs_stay_in_order_when_the_clock_is_set_back(self, catalog, monkeypatch):
        class SetBack(datetime):
            @classmethod
            def now(cls, tz=None):
                return next(times)

        now = datetime.now(UTC)
        times = (now - timedelta(days=days) for days in range(20_000))
        monkeypatch.setattr("storage.catalog.jobs.datetime", SetBack)
        ids = [catalog.jobs.create("campus", {}).id for _ in range(3)]
        first = catalog.jobs.list(limit=2)
        assert [job.id for job in first.items] == ids[:0:-1]
        assert [job.id for job in catalog.jobs.list(after=first.next_after).items] == ids[:1]
        assert [catalog.jobs.claim().id for _ in ids] == ids

    @pytest.mark.parametrize("cursor", ["none", "-1-a", "1-", "1-a\0b"])
    def test_what_is_no_cursor_is_rejected(self, catalog, cursor):
        with pytest.raises(InvalidParameters, match="is not one of this list"):
            catalog.jobs.list(after=cursor)
