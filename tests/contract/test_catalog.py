"""What the catalog promises of maps and itself, on every database that it supports."""

from concurrent.futures import ThreadPoolExecutor
from datetime import UTC

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

from core.errors import InvalidParameters
from storage.catalog import (
    Catalog,
    database,
    migrations,
)
from storage.catalog.models import Base
from storage.errors import (
    DriveNotFound,
    InvalidSlug,
    JobNotFound,
    KeyNotFound,
    LostRace,
    MapChanged,
    MapExists,
    MapNotFound,
    RevisionNotFound,
)
from tests.support.catalog_rows import scan_record
from tests.support.purges import purge_map


class TestMaps:
    def test_a_map_is_there_once_made_and_gone_once_deleted(self, catalog):
        made = catalog.maps.create("campus", "north gate")
        assert catalog.maps.get("campus") == made
        assert (made.slug, made.description, made.version) == ("campus", "north gate", 1)
        assert made.live_revision is None
        assert made.created_at.tzinfo is UTC
        assert purge_map(catalog, "campus").id == made.id
        with pytest.raises(MapNotFound, match="campus"):
            catalog.maps.get("campus")
        with pytest.raises(MapNotFound):
            purge_map(catalog, "campus")

    def test_no_two_maps_have_one_slug(self, catalog):
        catalog.maps.create("campus")
        with pytest.raises(MapExists, match="campus"):
            catalog.maps.create("campus")

    def test_a_name_that_is_no_slug_is_rejected(self, catalog):
        with pytest.raises(InvalidSlug):
            catalog.maps.create("../etc")

    def test_a_map_made_again_has_another_id(self, catalog):
        first = catalog.maps.create("campus")
        purge_map(catalog, "campus")
        assert catalog.maps.create("campus").id != first.id

    def test_a_map_made_again_has_none_of_the_versions_of_those_that_had_its_name(self, catalog):
        catalog.maps.create("campus")
        catalog.maps.update("campus", description="first")
        catalog.maps.create("dock")
        versions = []
        for _ in range(2):
            purge_map(catalog, "campus")
            versions.append(catalog.maps.create("campus").version)
        assert versions[0] > 2
        assert versions[1] > versions[0]
        purge_map(catalog, "dock")
        assert catalog.maps.create("dock").version < versions[0]

    def test_each_change_counts_the_version_up_and_no_change_does_not(self, catalog):
        catalog.maps.create("campus")
        assert catalog.maps.update("campus", description="new").version == 2
        assert catalog.maps.update("campus", description="new").version == 2

    def test_a_change_of_another_version_is_rejected(self, catalog):
        catalog.maps.create("campus")
        catalog.maps.update("campus", description="new", if_versions=(1,))
        with pytest.raises(MapChanged, match="version 2, not 1"):
            catalog.maps.update("campus", description="late", if_versions=(1,))
        with pytest.raises(MapChanged):
            purge_map(catalog, "campus", if_versions=(1,))
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

    def test_an_empty_page_is_rejected(self, catalog):
        with pytest.raises(InvalidParameters):
            catalog.maps.list(limit=0)


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

    def test_many_can_open_a_new_catalog_at_once(self, database_url, monkeypatch):
        monkeypatch.setattr(database, "upgrade", migrations.upgrade)  # not what repeats it
        with ThreadPoolExecutor(6) as pool:
            catalogs = list(pool.map(Catalog, [database_url] * 6))
        for number, catalog in enumerate(catalogs):
            catalog.maps.create(f"map-{number}")
            catalog.close()

    def test_a_store_gets_one_id_from_the_first_caller(self, database_url, catalog):
        other = Catalog(database_url)
        ids = iter("abcdefgh")
        with ThreadPoolExecutor(4) as pool:
            futures = [
                pool.submit(c.store_id.ensure, lambda: next(ids)) for c in [catalog, other] * 4
            ]
        assert {future.result() for future in futures} == {"a"}
        assert next(ids) == "b"
        other.close()

    def test_the_schema_is_that_of_the_models(self, catalog):
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
