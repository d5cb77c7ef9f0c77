"""Shared bases in the catalog, and all maps with what they answer from, on each database."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import pytest
from sqlalchemy import event

from storage.catalog import MapSummary, RevisionFacts
from storage.errors import BasisExists, BasisInUse, BasisNotFound, InvalidSlug
from tests.support.purges import purge_map

CITY, TOWN = "c" * 64, "d" * 64


def add(catalog, slug, revision, *bases, **options):
    of_map = catalog.maps.get(slug) if options else catalog.maps.create(slug)
    facts = RevisionFacts("harmonic", 7, 1, {}, bases=bases)
    catalog.revisions.add(of_map.id, revision, f"{revision[:8]}.h5", 10, facts, **options)
    return of_map.id


def test_a_basis_is_found_by_its_name_and_its_digest(catalog):
    added = catalog.bases.add("city", CITY, "c.h5", "harmonic", 800)
    for named in ("city", CITY, CITY[:16].upper()):
        assert catalog.bases.get(named).digest == added.digest
    for named in ("cit", CITY[:11], TOWN, "100%"):
        with pytest.raises(BasisNotFound):
            catalog.bases.get(named)
    assert catalog.bases.files() == {"c.h5": CITY}


def test_a_name_has_one_basis_and_a_basis_one_name(catalog):
    catalog.bases.add("city", CITY, "c.h5", "harmonic", 800)
    assert catalog.bases.add("city", CITY, "other.h5", "harmonic", 800).file_name == "c.h5"
    for name, digest in (("city", TOWN), ("town", CITY)):
        with pytest.raises(BasisExists):
            catalog.bases.add(name, digest, "d.h5", "harmonic", 800)
    with pytest.raises(InvalidSlug):
        catalog.bases.add("A city", TOWN, "d.h5", "harmonic", 800)
    catalog.bases.add("town", TOWN, "d.h5", "harmonic", 800)
    page = catalog.bases.list(limit=1)
    assert ([one.name for one in page.items], page.next_after) == (["city"], "city")
    assert [one.name for one in catalog.bases.list(after="city").items] == ["town"]


def test_of_two_that_add_the_same_basis_at_once_both_get_its_record(catalog):
    with ThreadPoolExecutor(2) as pool:
        for number in range(20):
            begin = Barrier(2)

            def added(file, number=number, begin=begin):
                begin.wait()
                return catalog.bases.add(f"city-{number}", f"{number:064x}", file, "harmonic", 800)

            one, other = pool.map(added, (f"{number}-a.h5", f"{number}-b.h5"))
            assert one == other


def test_a_basis_stays_while_a_revision_has_it_or_a_job_will_use_it(catalog):
    catalog.bases.add("city", CITY, "c.h5", "harmonic", 800)
    add(catalog, "north", "1" * 64, CITY)
    with pytest.raises(BasisInUse):
        catalog.bases.delete("city")
    purge_map(catalog, "north")
    catalog.maps.create("south")
    job = catalog.jobs.create("south", {}, plan={"basis": CITY})
    with pytest.raises(BasisInUse):
        catalog.bases.delete("city")
    catalog.jobs.request_cancel(job.id)
    assert catalog.bases.delete("city").file_name == "c.h5"
    with pytest.raises(BasisNotFound):
        catalog.bases.delete("city")


def test_a_basis_stays_if_a_build_that_uses_it_ends_while_it_is_deleted(catalog):
    engine = catalog._database.engine
    if engine.dialect.name == "sqlite":
        pytest.skip("SQLite has one writer at a time")
    catalog.bases.add("city", CITY, "c.h5", "harmonic", 800)
    of_map = catalog.maps.create("south")
    job = catalog.jobs.create("south", {}, plan={"basis": CITY})
    catalog.jobs.claim()
    ended: list[str] = []

    def end_the_build(_connection, _cursor, statement, *_):
        if not ended and ("FROM jobs" in statement or "FROM revision_bases" in statement):
            ended.append(statement)
            facts = RevisionFacts("harmonic", 7, 1, {}, bases=(CITY,), job_id=job.id)
            catalog.revisions.add(of_map.id, "1" * 64, "1.h5", 10, facts)

    event.listen(engine, "after_cursor_execute", end_the_build)
    with pytest.raises(BasisInUse):
        catalog.bases.delete("city")
    event.remove(engine, "after_cursor_execute", end_the_build)
    assert catalog.jobs.get(job.id).ended
    assert catalog.bases.get("city").digest == CITY


def test_all_maps_are_listed_with_their_live_revision_and_shared_basis(catalog):
    catalog.bases.add("city", CITY, "c.h5", "harmonic", 800)
    north = add(catalog, "north", "1" * 64, CITY)
    south = add(catalog, "south", "2" * 64, TOWN)
    empty = catalog.maps.create("empty").id
    maps = catalog.map_summaries.all()
    assert list(maps) == [
        MapSummary(empty, "empty", None, "", 0, None),
        MapSummary(north, "north", "1" * 64, "11111111.h5", 7, CITY),
        MapSummary(south, "south", "2" * 64, "22222222.h5", 7, None),
    ]
    assert list(catalog.map_summaries.all({"south", "none"})) == [maps[2]]
    add(catalog, "south", "3" * 64, CITY, make_live=True)
    assert catalog.map_summaries.all()[2].basis == CITY
    assert catalog.map_summaries.with_basis(CITY[:16]) == {north, south}
    assert catalog.map_summaries.with_basis(TOWN) == frozenset()
