"""What the catalog promises of jobs."""

from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from functools import partial
from threading import Barrier

import pytest

from core.errors import InvalidParameters
from storage.catalog import IdempotencyKey, JobState, RevisionFacts
from storage.catalog.pages import PAGE_CHARACTERS, all_items
from storage.errors import (
    JobNotFound,
    JobNotRunning,
    MapNotFound,
    RequestKeyReused,
    TooManyBuilds,
)
from tests.support.catalog_rows import A, B
from tests.support.purges import purge_map
from tests.support.sqlite_limits import allow_999_variables


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

    def test_more_jobs_are_read_at_once_than_a_statement_may_name(self, catalog):
        made = [catalog.jobs.create("campus", {}) for _ in range(2)]
        ids = [made[0].id, *(f"{number:032x}" for number in range(1_100)), made[1].id]
        allow_999_variables(catalog)
        assert catalog.jobs.with_ids(ids) == {job.id: job for job in made}
        assert catalog.jobs.with_ids(set()) == {}

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

    def test_no_key_exceeds_its_limit_by_requests_at_once(self, catalog):
        catalog.maps.create("dock")
        together = Barrier(16)

        def queue(number):
            together.wait()
            slug = ("campus", "dock")[number % 2]
            catalog.jobs.create(slug, {}, key_id="greedy", most_queued=2)

        with ThreadPoolExecutor(16) as pool:
            asked = [pool.submit(queue, number) for number in range(16)]
        kinds = [type(one.exception()) for one in asked]
        assert (kinds.count(type(None)), kinds.count(TooManyBuilds)) == (2, 14)
        assert catalog.jobs.counts() == {JobState.QUEUED: 2}

    def test_a_repeated_request_is_answered_even_when_the_queue_is_full(self, catalog):
        key = IdempotencyKey("retry-1", A)
        made = catalog.jobs.create("campus", {}, idempotency_key=key, key_id="a", most_queued=1)
        again = catalog.jobs.create("campus", {}, idempotency_key=key, key_id="a", most_queued=1)
        assert again == made

    def test_a_request_of_another_map_with_the_same_key_makes_a_job_of_its_own(self, catalog):
        catalog.maps.create("dock")
        one, other = IdempotencyKey("retry-1", A), IdempotencyKey("retry-1", B)
        first = catalog.jobs.create("campus", {}, idempotency_key=one, key_id="a")
        assert catalog.jobs.made_by("dock", one, "a") is None
        second = catalog.jobs.create("dock", {}, idempotency_key=other, key_id="a")
        assert catalog.jobs.made_by("campus", one, "a").id == first.id
        assert catalog.jobs.made_by("dock", other, "a").id == second.id

    def test_a_request_of_another_key_with_the_same_name_makes_a_job_of_its_own(self, catalog):
        one, other = IdempotencyKey("retry-1", A), IdempotencyKey("retry-1", B)
        first = catalog.jobs.create("campus", {}, idempotency_key=one, key_id="a")
        assert catalog.jobs.made_by("campus", one, "b") is None
        second = catalog.jobs.create("campus", {}, idempotency_key=other, key_id="b")
        assert first.id != second.id
        assert catalog.jobs.made_by("campus", one, "a").id == first.id
        assert catalog.jobs.made_by("campus", other, "b").id == second.id

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
        requested = {"idempotency_key": key, "key_id": "a"}
        assert catalog.jobs.made_by("campus", key, "a") is None
        with ThreadPoolExecutor(4) as pool:
            made = list(
                pool.map(lambda _: catalog.jobs.create("campus", {}, **requested), range(12))
            )
        assert len({job.id for job in made}) == 1
        assert [job.id for job in catalog.jobs.list().items] == [made[0].id]
        assert catalog.jobs.made_by("campus", key, "a") == made[0]
        catalog.maps.create("dock")
        assert catalog.jobs.create("dock", {}, **requested).id != made[0].id

    def test_an_idempotency_key_is_of_one_request(self, catalog):
        one, other = IdempotencyKey("retry-1", A), IdempotencyKey("retry-1", B)
        catalog.jobs.create("campus", {}, idempotency_key=one, key_id="a")
        for call in (
            lambda: catalog.jobs.made_by("campus", other, "a"),
            lambda: catalog.jobs.create("campus", {}, idempotency_key=other, key_id="a"),
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
            purge_map(catalog, "campus")
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

    def test_texts_that_a_recording_made_are_kept_in_part(self, catalog):
        """A bag of 12 kB had topics of 120 MB: each list of jobs, and the log, had them whole."""
        for _ in range(3):
            catalog.jobs.create("campus", {})
        text = f"no topic of these: {'x' * 10**6}; 2 of its 9 scans are stored"
        failed = catalog.jobs.fail(catalog.jobs.claim().id, "EmptyDrive", text)
        done = catalog.jobs.finish(catalog.jobs.claim().id, None, notes=[text, "short"])
        facts = RevisionFacts(
            "paper", 9, 1, {}, job_id=catalog.jobs.claim().id, notes=(text, "short")
        )
        catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, facts)
        built = catalog.jobs.get(facts.job_id)
        for kept in (failed.error_detail, done.notes[0], built.notes[0]):
            assert len(kept) == 4000
            assert kept.startswith("no topic of these: xxx")
            assert kept.endswith("xxx; 2 of its 9 scans are stored")
        assert done.notes[1] == built.notes[1] == "short"

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

    def test_a_page_ends_early_where_its_jobs_have_much_text_and_has_one_at_least(self, catalog):
        large = {"add": ["x" * 64] * (PAGE_CHARACTERS // 64)}
        ids = [catalog.jobs.create("campus", parameters).id for parameters in (large, {}, large)]
        page = catalog.jobs.list()
        assert [job.id for job in page.items] == [ids[2]]
        assert [job.id for job in all_items(partial(catalog.jobs.list, None))] == ids[::-1]
        assert catalog.jobs.list(limit=3, after=page.next_after).next_after is not None

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
