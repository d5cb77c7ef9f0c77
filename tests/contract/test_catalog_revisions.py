"""What the catalog promises of revisions."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from core.errors import InvalidParameters
from storage.catalog import JobState
from storage.errors import (
    AmbiguousRevision,
    LostRace,
    MapChanged,
    MapNotFound,
    NoLiveRevision,
    RevisionIsLive,
    RevisionNotFound,
)
from storage.retention import Retention
from tests.support.catalog_rows import FACTS, A, B, C
from tests.support.purges import purge_map


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
        assert catalog.revisions.files_by_map() == {added.map_id: {"a.h5": A, "b.h5": B}}

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
        assert catalog.revisions.set_live("campus", A[:12]) == catalog.maps.get("campus")
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

    def test_a_map_is_changed_only_if_that_revision_is_live_to_which_the_change_belongs(
        self, catalog
    ):
        for digest in (A, B):
            catalog.revisions.add(catalog.maps.get("campus").id, digest, digest, 10, FACTS)
        with pytest.raises(MapChanged, match="became live meanwhile"):
            catalog.maps.update("campus", description="of B", if_live=B)
        assert catalog.maps.get("campus").description == ""
        assert catalog.maps.update("campus", description="of A", if_live=A).description == "of A"

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

    def test_one_that_was_imported_and_is_then_built_is_recorded_as_built(self, catalog):
        campus = catalog.maps.get("campus").id
        catalog.revisions.add(campus, A, "a.h5", 10, replace(FACTS, parameters={"imported": True}))
        job = catalog.jobs.create("campus", {})
        catalog.jobs.claim()
        added = catalog.revisions.add(campus, A, "b.h5", 10, replace(FACTS, job_id=job.id))
        assert (added.job_id, added.parameters) == (job.id, FACTS.parameters)
        assert added.file_name == "a.h5"
        catalog.revisions.add(campus, A, "c.h5", 10, replace(FACTS, parameters={"imported": True}))
        assert catalog.revisions.get("campus", A).parameters == FACTS.parameters

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
        purge_map(catalog, "campus")
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
