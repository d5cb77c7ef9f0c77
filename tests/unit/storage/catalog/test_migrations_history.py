"""A catalog of the first release is upgraded to the newest schema, and answers."""

import json
import sqlite3
from contextlib import closing
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from alembic import command
from sqlalchemy import create_engine, event, text

from core.scans.pose import Pose
from storage.catalog import Catalog, IdempotencyKey, JobState, NewCapture
from storage.catalog.migrations import alembic_config
from storage.catalog.models import RevisionRecord
from storage.errors import WrongCatalog
from storage.retention import OwnRetention
from storage.store import Store
from tests.support.catalog_rows import FACTS, add_scans
from tests.support.purges import purge_map

AT = "2024-02-29 12:00:00.123456"
M, D, E, J, K, S = (letter * 32 for letter in "abcdef")
DIGEST = "1" * 64
POSE = [1.5, -2.0, 0.0, 0.0, 0.0, 0.6, 0.8]

# What the first release wrote: of every table a row.
ROWS: dict[str, dict[str, Any]] = {
    "store": {"row": 1, "id": S},
    "maps": {"id": M, "slug": "campus", "description": "north", "created_at": AT, "version": 2},
    "drives": {"id": D, "map_id": M, "slug": "monday", "created_at": AT, "closed": False},
    "scans": {
        "drive_id": D,
        "scan_index": 7,
        "chunk": "one.h5",
        "chunk_row": 0,
        "digest": DIGEST,
        "returns": 120,
        "dropped_returns": 3,
        "timestamp_s": 12.5,
        "pose": json.dumps(POSE),
    },
    "revisions": {
        "map_id": M,
        "digest": DIGEST,
        "file_name": "one.h5",
        "encoding": "paper",
        "scans": 1,
        "segments": 1,
        "parameters": json.dumps({"ranks": [5, 5]}),
        "size_bytes": 1000,
        "job_id": J,
        "created_at": AT,
    },
    "live_revisions": {"map_id": M, "digest": DIGEST},
    "jobs": {
        "id": J,
        "map_id": M,
        "kind": "build",
        "state": "done",
        "stage": "publish",
        "done_units": 1,
        "total_units": 1,
        "parameters": json.dumps({"ranks": [5, 5]}),
        "error_type": None,
        "error_detail": None,
        "revision": DIGEST,
        "cancel_requested": False,
        "created_at": AT,
        "started_at": AT,
        "finished_at": AT,
    },
    "keys": {"id": K, "secret_hash": "hash", "scopes": json.dumps(["admin"]), "created_at": AT},
}


def write_first_release(url, schema="0001"):
    """Make a database as the first release left it, by its own migration and in plain SQL."""
    engine = create_engine(url)
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", lambda raw, _: setattr(raw, "isolation_level", None))
        event.listen(engine, "begin", lambda connection: connection.exec_driver_sql("BEGIN"))
    with engine.begin() as connection:
        config = alembic_config()
        config.attributes["connection"] = connection
        command.upgrade(config, schema)
    zone = "+00" if engine.dialect.name == "postgresql" else ""
    with engine.begin() as connection:
        for table, row in ROWS.items():
            names = ", ".join(f'"{name}"' for name in row)
            values = ", ".join(f":{name}" for name in row)
            converted = {name: f"{v}{zone}" if v == AT else v for name, v in row.items()}
            connection.execute(text(f"INSERT INTO {table} ({names}) VALUES ({values})"), converted)
    engine.dispose()


@pytest.mark.parametrize("schema", ["0001", "0002"])
def test_a_catalog_of_an_earlier_release_is_upgraded_and_answers(database_url, schema):
    write_first_release(database_url, schema)
    for _ in range(2):  # the second time there is nothing to do
        catalog = Catalog(database_url)
        at = datetime(2024, 2, 29, 12, 0, 0, 123456, UTC)
        found = catalog.maps.get("campus")
        assert (found.id, found.description, found.version, found.created_at) == (M, "north", 2, at)
        assert found.live_revision == DIGEST
        assert catalog.store_id.get() == S
        drive = catalog.drives.get("campus", "monday")
        assert (drive.scans, drive.returns, drive.closed) == (1, 120, False)
        assert (drive.mounting, drive.accumulate) == (None, 1)
        scan = catalog.scans.get(D, 7)
        assert (scan.digest, scan.timestamp_s, scan.pose) == (DIGEST, 12.5, Pose(*POSE))
        revision = catalog.revisions.live("campus")
        assert (revision.encoding, revision.parameters) == ("paper", {"ranks": [5, 5]})
        assert (revision.drive_ids, revision.number) == ({}, 1)
        assert found.retention == OwnRetention()
        with catalog._database.reading() as session:  # retained from the upgrade on
            retained_from = session.get_one(RevisionRecord, (M, DIGEST)).retained_from
        assert retained_from is not None
        assert retained_from > revision.created_at + timedelta(days=1)
        job = catalog.jobs.get(J)
        assert (job.state, job.revision, job.notes) == (JobState.DONE, DIGEST, [])
        assert (job.key_id, job.crashes, job.number) == (None, 0, 1)
        [key] = catalog.keys.list().items
        assert (key.id, key.secret_hash, key.scopes, key.revoked_at) == (
            K,
            "hash",
            ["admin"],
            None,
        )
        catalog.close()
    catalog = Catalog(database_url)  # and it can be written
    assert catalog.maps.update("campus", description="south").version == 3
    assert catalog.jobs.create("campus", {}).state is JobState.QUEUED
    assert purge_map(catalog, "campus").map_slug == "campus"
    catalog.close()


def test_every_schema_can_be_left_for_the_one_before_it(database_url):
    write_first_release(database_url)
    catalog = Catalog(database_url)
    with catalog._database.engine.begin() as connection:
        config = alembic_config()
        config.attributes["connection"] = connection
        command.downgrade(config, "0001")
    catalog.close()
    again = Catalog(database_url)
    assert again.maps.get("campus").id == M
    again.close()


def test_what_is_in_the_recycle_bin_is_removed_with_its_schema_and_all_else_stays(database_url):
    catalog = Catalog(database_url)
    catalog.maps.create("yard")
    for slug in ("campus", "dock"):
        added = catalog.maps.create(slug)
        catalog.revisions.add(added.id, DIGEST, "one.h5", 1000, FACTS)
        for drive in ("monday", "tuesday"):
            catalog.drives.put(slug, drive, None, 1)
    catalog.recycle_bin.put_map("campus")
    catalog.recycle_bin.put_drive("dock", "monday")
    with catalog._database.engine.begin() as connection:
        config = alembic_config()
        config.attributes["connection"] = connection
        command.downgrade(config, "0015")
    catalog.close()
    again = Catalog(database_url)
    assert [one.slug for one in again.maps.list().items] == ["dock", "yard"]
    assert again.drives.slugs("dock") == ("tuesday",)
    assert sorted(map(len, again.drives.by_map().values())) == [0, 1]
    assert again.recycle_bin.list().items == ()
    again.close()


def test_what_is_half_purged_is_removed_with_its_schema_and_the_bin_stays(database_url):
    catalog = Catalog(database_url)
    for slug in ("campus", "dock"):
        added = catalog.maps.create(slug)
        catalog.revisions.add(added.id, DIGEST, "one.h5", 1000, FACTS)
        for drive in ("monday", "tuesday"):
            add_scans(catalog, slug, drive, range(9))
    kept = catalog.recycle_bin.put_drive("dock", "tuesday")
    for entry in (
        catalog.recycle_bin.put_map("campus", purging=True),
        catalog.recycle_bin.put_drive("dock", "monday", purging=True),
    ):
        [purge] = [one for one in catalog.purges.begun() if one.id == entry.id]
        assert catalog.purges.remove_some(purge, rows=4)
    with catalog._database.engine.begin() as connection:
        config = alembic_config()
        config.attributes["connection"] = connection
        command.downgrade(config, "0022")
    catalog.close()
    again = Catalog(database_url)
    assert [one.slug for one in again.maps.list().items] == ["dock"]
    assert again.drives.slugs("dock") == ()
    assert again.recycle_bin.list().items == (kept,)
    assert again.purges.begun() == []
    again.recycle_bin.restore(kept.id)
    assert again.drives.get("dock", "tuesday").scans == 9
    again.close()


def test_jobs_that_an_earlier_release_cannot_show_are_removed_or_lose_their_parameters(
    database_url,
):
    catalog = Catalog(database_url)
    catalog.maps.create("campus")
    new = {"align": "auto", "odometry": True}
    build = catalog.jobs.create("campus", {"views": "any", **new}, plan={"parameters": new})
    planless = catalog.jobs.create("campus", new)
    capture, _ = catalog.captures.create("campus", NewCapture("monday", (("a.bag", 9),), 9))
    catalog.captures.add_part("campus", "monday", capture.id, 0, DIGEST, "0.bin")
    catalog.captures.complete("campus", "monday", capture.id)
    with catalog._database.engine.begin() as connection:
        config = alembic_config()
        config.attributes["connection"] = connection
        command.downgrade(config, "0013")
    catalog.close()
    again = Catalog(database_url)
    jobs = {job.id: (job.parameters, job.plan) for job in again.jobs.list().items}
    assert jobs == {build.id: ({"views": "any"}, {"parameters": {}}), planless.id: ({}, None)}
    again.close()


def test_of_equal_idempotency_keys_of_several_keys_an_earlier_release_has_the_first(database_url):
    catalog = Catalog(database_url)
    catalog.maps.create("campus")
    request = IdempotencyKey("nightly", DIGEST)
    made = [catalog.jobs.create("campus", {}, idempotency_key=request, key_id=key) for key in "bac"]
    assert len({job.id for job in made}) == 3
    with catalog._database.engine.begin() as connection:
        config = alembic_config()
        config.attributes["connection"] = connection
        command.downgrade(config, "0024")
    catalog.close()
    again = Catalog(database_url)
    found = [again.jobs.made_by("campus", request, key) for key in "bac"]
    assert [job and job.id for job in found] == [made[0].id, None, None]
    again.close()


def test_a_store_of_the_first_release_is_opened_and_served(tmp_path):
    data = tmp_path / "data"
    (data / "maps/m1").mkdir(parents=True)
    (data / "store-id").write_text(f"{S}\n")
    write_first_release(f"sqlite:///{data / 'catalog.sqlite3'}")
    with Store.serving(data) as store:
        assert store.maps.get("campus").live_revision == DIGEST


def test_a_catalog_of_a_later_release_is_rejected_and_stays_as_it_is(tmp_path):
    path = tmp_path / "catalog.sqlite3"
    Catalog(f"sqlite:///{path}").close()
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    connection.close()
    before = path.read_bytes()
    with pytest.raises(WrongCatalog, match="9999"):
        Catalog(f"sqlite:///{path}")
    assert path.read_bytes() == before
