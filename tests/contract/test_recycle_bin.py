"""What the catalog promises of deleted maps and drives, on every database that it supports."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import insert

from storage.catalog import JobState
from storage.catalog.models import Drive, Recycled
from storage.errors import (
    DriveExists,
    DriveNotFound,
    InvalidSlug,
    JobNotFound,
    MapChanged,
    MapExists,
    MapNotFound,
    NotInRecycleBin,
)
from storage.names import recycled_slug
from tests.support.catalog_queries import writers_queries
from tests.support.catalog_rows import FACTS, A, add_scans
from tests.support.purges import finish_purges, purge_entry
from tests.support.sqlite_limits import allow_999_variables


@pytest.fixture
def campus(catalog):
    """A catalog with a map of a revision, two drives and a queued job, and the map."""
    made = catalog.maps.create("campus")
    add_scans(catalog, "campus", "monday", [0, 1])
    add_scans(catalog, "campus", "tuesday", [0])
    catalog.revisions.add(made.id, A, "a.h5", 1000, FACTS)
    return catalog.maps.get("campus")


def test_a_deleted_map_is_found_by_no_name_and_no_id(catalog, campus):
    job = catalog.jobs.create("campus", {})
    entry = catalog.recycle_bin.put_map("campus")
    assert (entry.id, entry.map_slug, entry.drive_slug) == (campus.id, "campus", None)
    for slug in ("campus", recycled_slug(campus.id)):
        for find in (catalog.maps.get, catalog.drives.list, catalog.revisions.live):
            with pytest.raises(MapNotFound):
                find(slug)
    for find in (catalog.maps.get_by_id, catalog.drives.of_map):
        with pytest.raises(MapNotFound):
            find(campus.id)
    assert (
        catalog.maps.list().items == catalog.map_summaries.all() == catalog.jobs.list().items == ()
    )
    assert catalog.jobs.claim() is None
    purge_entry(catalog, entry.id)
    with pytest.raises(JobNotFound):
        catalog.jobs.get(job.id)
    assert catalog.jobs.with_ids([job.id]) == {}


def test_a_job_of_a_deleted_map_is_cancelled_and_found_by_its_id(catalog, campus):
    running, queued = (catalog.jobs.create("campus", {}) for _ in range(2))
    assert catalog.jobs.claim() == catalog.jobs.get(running.id)
    catalog.recycle_bin.put_map("campus")
    assert catalog.jobs.progress(running.id, "fitting", 1, 2).cancel_requested
    assert catalog.jobs.fail(running.id, "MapNotFound", "gone").state is JobState.CANCELLED
    found = catalog.jobs.with_ids([running.id, queued.id])
    for job in (running, queued):
        assert catalog.jobs.get(job.id) == found[job.id]
        assert found[job.id].state is JobState.CANCELLED
        assert found[job.id].map_slug == "campus"
        assert found[job.id].error_type is None


def test_a_restored_map_is_as_it_was_and_its_open_jobs_are_cancelled(catalog, campus):
    job = catalog.jobs.create("campus", {})
    before = catalog.drives.list("campus")
    entry = catalog.recycle_bin.put_map("campus")
    assert catalog.recycle_bin.restore(entry.id).map_slug == "campus"
    restored = catalog.maps.get("campus")
    assert (restored.id, restored.live_revision) == (campus.id, A)
    assert restored.version == campus.version + 1
    assert catalog.drives.list("campus") == before
    assert catalog.jobs.get(job.id).state is JobState.CANCELLED
    assert catalog.recycle_bin.list().items == ()


def test_a_name_can_be_reused_and_the_deleted_map_restored_under_another(catalog, campus):
    entry = catalog.recycle_bin.put_map("campus")
    again = catalog.maps.create("campus")
    with pytest.raises(MapExists, match=r"another name, with `\?name=`"):
        catalog.recycle_bin.restore(entry.id)
    with pytest.raises(InvalidSlug):
        catalog.recycle_bin.restore(entry.id, recycled_slug(entry.id))
    assert catalog.recycle_bin.restore(entry.id, "old").map_slug == "old"
    assert catalog.maps.get("old").id == campus.id
    assert catalog.maps.get("campus").id == again.id


def test_no_version_of_a_deleted_map_is_one_of_another_map_of_its_name(catalog, campus):
    def delete():
        return catalog.recycle_bin.put_map("campus")

    seen = [campus.version]
    first = delete()
    for version in (campus.version + 1, campus.version + 2):
        seen.append(catalog.maps.create("campus").version)
        assert seen[-1] == version
        with pytest.raises(MapChanged):
            catalog.maps.update("campus", description="another", if_versions=seen[:-1])
        delete()
    catalog.recycle_bin.restore(first.id)
    assert catalog.maps.get("campus").version == max(seen) + 1
    assert catalog.maps.create("dock").version == 1
    catalog.recycle_bin.put_map("dock")
    entry = delete()
    catalog.recycle_bin.restore(entry.id, "dock")
    assert catalog.maps.get("dock").version == max(seen) + 2


def test_a_deleted_drive_is_gone_from_its_map_and_restored_as_it_was(catalog, campus):
    before = catalog.drives.get("campus", "monday")
    entry = catalog.recycle_bin.put_drive("campus", "monday")
    assert (entry.map_slug, entry.drive_slug) == ("campus", "monday")
    for slug in ("monday", recycled_slug(entry.id)):
        with pytest.raises(DriveNotFound):
            catalog.drives.get("campus", slug)
        with pytest.raises(DriveNotFound):
            catalog.drives.of_map(campus.id, [slug])
    with pytest.raises(DriveNotFound):
        catalog.drives.require(entry.id, "monday")
    with pytest.raises(InvalidSlug):
        catalog.scans.target("campus", recycled_slug(entry.id), [])
    assert catalog.drives.slugs("campus") == ("tuesday",)
    assert [drive.slug for drive in catalog.drives.of_map(campus.id)] == ["tuesday"]
    assert catalog.drives.by_map() == {campus.id: set(catalog.drives.slugs_by_id()) - {campus.id}}
    assert catalog.drives.slugs_by_id()[entry.id] == "monday"
    add_scans(catalog, "campus", "monday", [7])
    with pytest.raises(DriveExists, match=r"another name, with `\?name=`"):
        catalog.recycle_bin.restore(entry.id)
    catalog.recycle_bin.restore(entry.id, "sunday")
    restored = catalog.drives.get("campus", "sunday")
    assert (restored.id, restored.present) == (before.id, before.present)


def test_a_deleted_drive_of_a_deleted_map_is_part_of_that(catalog, campus):
    drive = catalog.recycle_bin.put_drive("campus", "monday")
    of_map = catalog.recycle_bin.put_map("campus")
    assert [entry.id for entry in catalog.recycle_bin.list().items] == [of_map.id]
    with pytest.raises(NotInRecycleBin):
        catalog.recycle_bin.restore(drive.id)
    catalog.recycle_bin.restore(of_map.id)
    assert [entry.id for entry in catalog.recycle_bin.list().items] == [drive.id]
    catalog.recycle_bin.put_map("campus")
    purge_entry(catalog, of_map.id)
    assert catalog.recycle_bin.expired(drive.deleted_at + timedelta(days=1)) == []
    assert catalog.drives.by_map() == {}
    with pytest.raises(NotInRecycleBin):
        catalog.recycle_bin.begin_purge(of_map.id)


def test_a_deleted_drive_expires_with_its_map_and_has_the_whole_time_again_if_that_is_restored(
    catalog, campus
):
    drive = catalog.recycle_bin.put_drive("campus", "monday")
    of_map = catalog.recycle_bin.put_map("campus")
    later = of_map.deleted_at + timedelta(days=1)
    assert [entry.id for entry in catalog.recycle_bin.expired(later)] == [of_map.id]
    with pytest.raises(NotInRecycleBin):  # listed as expired before its map was deleted
        catalog.recycle_bin.begin_purge(drive.id, before=later)
    with pytest.raises(NotInRecycleBin):
        catalog.recycle_bin.begin_purge(drive.id)
    catalog.recycle_bin.restore(of_map.id)
    assert catalog.recycle_bin.expired(of_map.deleted_at) == []
    [restored] = catalog.recycle_bin.list().items
    assert restored == replace(drive, deleted_at=restored.deleted_at)
    assert restored.deleted_at >= of_map.deleted_at
    assert catalog.recycle_bin.expired(restored.deleted_at) == [restored]
    catalog.recycle_bin.begin_purge(drive.id)


def test_entries_are_listed_the_last_one_first_and_for_maps_of_a_key(catalog, campus):
    first = catalog.recycle_bin.put_drive("campus", "monday")
    catalog.maps.create("dock")
    second = catalog.recycle_bin.put_map("dock")
    page = catalog.recycle_bin.list(limit=1)
    assert [entry.id for entry in page.items] == [second.id]
    assert [one.id for one in catalog.recycle_bin.list(page.next_after).items] == [first.id]
    for slug, entry in (("campus", first), ("dock", second)):
        assert catalog.recycle_bin.list(slugs=[slug]).items == (entry,)
    assert catalog.recycle_bin.list(slugs=["monday"]).items == ()
    purge_entry(catalog, second.id)  # the cursor need not be there
    assert [one.id for one in catalog.recycle_bin.list(page.next_after).items] == [first.id]


def test_an_entry_is_purged_once_it_is_old_enough(catalog, campus):
    entry = catalog.recycle_bin.put_drive("campus", "monday")
    assert entry.size_bytes == 2 * 100 * 12
    before = entry.deleted_at - timedelta(seconds=1)
    assert catalog.recycle_bin.expired(before) == []
    with pytest.raises(NotInRecycleBin):
        catalog.recycle_bin.begin_purge(entry.id, before=before)
    assert catalog.recycle_bin.expired(entry.deleted_at) == [entry]
    catalog.recycle_bin.begin_purge(entry.id, before=entry.deleted_at)
    finish_purges(catalog)
    assert entry.id not in catalog.drives.slugs_by_id()
    with pytest.raises(NotInRecycleBin):
        catalog.recycle_bin.get(entry.id)


def test_no_scan_is_summed_up_while_others_wait_to_write(catalog, campus):
    with writers_queries(catalog) as queries:
        drive = catalog.recycle_bin.put_drive("campus", "monday")
        assert catalog.recycle_bin.restore(drive.id) == drive
        of_map = catalog.recycle_bin.put_map("campus")
        assert of_map.size_bytes == 3 * 100 * 12 + 1000
        assert catalog.recycle_bin.begin_purge(of_map.id) == of_map
    assert queries
    assert not [query for query in queries if "scans" in query]


def test_more_entries_expire_than_a_statement_may_name(catalog, campus):
    at = datetime(2026, 1, 1, tzinfo=UTC)
    ids = [f"{number:032x}" for number in range(1_100)]
    common = {"map_id": campus.id, "created_at": at}
    with catalog._database.writing() as session:
        session.execute(insert(Drive), [{**common, "id": i, "slug": recycled_slug(i)} for i in ids])
        entries = [{**common, "id": i, "drive_id": i, "slug": f"d{i}"} for i in ids]
        session.execute(insert(Recycled), entries)
    allow_999_variables(catalog)
    found = catalog.recycle_bin.expired(at)
    assert [entry.id for entry in found] == ids
    assert {entry.map_slug for entry in found} == {"campus"}
    assert not catalog.recycle_bin.expired(at - timedelta(seconds=1))
