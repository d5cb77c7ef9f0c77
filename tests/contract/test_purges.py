"""What the catalog promises while a map or drive is removed, on every database it supports."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from sqlalchemy import event, func, insert, select

from storage.catalog import Act, Catalog, NewCapture, Purge, ScanPoses, on_behalf
from storage.catalog.models import Base, Drive, RevisionBasis
from storage.errors import (
    BasisInUse,
    DriveNotFound,
    JobNotFound,
    LostRace,
    MapNotFound,
    NotInRecycleBin,
)
from storage.names import recycled_slug
from tests.support.catalog_rows import FACTS, A, B, add_scans, scan_record
from tests.support.purges import finish_purges, purge_map

SCANS = 23


@pytest.fixture
def campus(catalog):
    """A catalog with a map that has rows in every table, and the map."""
    made = catalog.maps.create("campus")
    for drive in ("monday", "tuesday"):
        add_scans(catalog, "campus", drive, range(SCANS))
        poses = np.tile([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0], (3, 1))
        given = ScanPoses(np.arange(50, 53), poses, np.full(3, np.nan))
        catalog.poses.expect(catalog.scans.target("campus", drive, ()), given, partial=True)
    for digest in (A, B):
        catalog.revisions.add(made.id, digest, f"{digest[:1]}.h5", 1000, FACTS)
    bases = [{"map_id": made.id, "digest": A, "basis": f"{n:064x}"} for n in range(4)]
    with catalog._database.writing() as session:
        session.execute(insert(RevisionBasis), bases)
    new = NewCapture("monday", (("monday.bag", 50),), 10)
    capture, _ = catalog.captures.create("campus", new)
    for number in range(5):
        catalog.captures.add_part("campus", "monday", capture.id, number, A, f"{number}.bin")
    for _ in range(3):
        catalog.jobs.create("campus", {})
    catalog.recycle_bin.put_drive("campus", "tuesday")
    return catalog.maps.get("campus")


def rows(catalog: Catalog) -> dict[str, int]:
    """Return how many rows each table has that has some."""
    kept = {"alembic_version", "audit", "audit_head", "purged_maps", "store"}
    with catalog._database.reading() as session:
        counts = {
            name: session.scalar(select(func.count()).select_from(table)) or 0
            for name, table in Base.metadata.tables.items()
            if name not in kept
        }
    return {name: count for name, count in counts.items() if count}


@contextmanager
def removed_rows(catalog: Catalog) -> Iterator[list[int]]:
    """Collect how many rows each transaction of the block removes by its own statements."""
    engine, counts = catalog._database.engine, [0]

    def executed(_connection, cursor, statement, *_):
        if statement.startswith("DELETE"):
            counts[-1] += cursor.rowcount

    def committed(_connection):
        counts.append(0)

    event.listen(engine, "after_cursor_execute", executed)
    event.listen(engine, "commit", committed)
    try:
        yield counts
    finally:
        event.remove(engine, "after_cursor_execute", executed)
        event.remove(engine, "commit", committed)


def purge_of(entry) -> Purge:
    return Purge(entry.id, entry.map_id, None if entry.drive_slug is None else entry.id)


def test_no_transaction_of_a_purge_removes_more_than_a_batch(catalog, campus):
    purge = purge_of(catalog.recycle_bin.put_map("campus", purging=True))
    before = rows(catalog)
    with removed_rows(catalog) as counts:
        transactions = 1
        while catalog.purges.remove_some(purge, rows=7):
            transactions += 1
            left = rows(catalog)
            assert left != before  # each gets on
            before = left
    assert max(counts) <= 7 + 1  # and the row of the drive or capture that they were of
    assert transactions > 2 * SCANS // 7
    assert rows(catalog) == {"maps": 1, "recycle_bin": 1}
    catalog.purges.end(purge)
    assert rows(catalog) == {}
    assert catalog.purges.begun() == []


def test_a_purge_of_a_drive_leaves_the_rest_of_its_map(catalog, campus):
    [tuesday] = catalog.recycle_bin.list().items
    before = rows(catalog)
    catalog.recycle_bin.begin_purge(tuesday.id)
    purge = purge_of(tuesday)
    while catalog.purges.remove_some(purge, rows=4):
        pass
    catalog.purges.end(purge)
    left = rows(catalog)
    assert (before["scans"] - left["scans"], before["drives"] - left["drives"]) == (SCANS, 1)
    assert before["expected_poses"] - left["expected_poses"] == 3
    assert "recycle_bin" not in left
    assert catalog.drives.get("campus", "monday").scans == SCANS


@pytest.mark.parametrize("batches", [0, 3, 9])
def test_from_the_first_commit_on_a_purged_map_is_gone_for_everybody(catalog, campus, batches):
    [job, *_] = catalog.jobs.list().items
    basis = f"{3:064x}"
    catalog.bases.add("city", basis, "c.h5", "harmonic", 800)
    with pytest.raises(BasisInUse):
        catalog.bases.delete("city")
    entry = catalog.recycle_bin.put_map("campus")
    catalog.recycle_bin.begin_purge(entry.id)
    for _ in range(batches):
        catalog.purges.remove_some(purge_of(entry), rows=10)
    for find in (
        catalog.recycle_bin.get,
        catalog.recycle_bin.restore,
        catalog.recycle_bin.begin_purge,
    ):
        with pytest.raises(NotInRecycleBin):
            find(entry.id)
    with pytest.raises(NotInRecycleBin):
        catalog.recycle_bin.restore(entry.id, "another")
    assert catalog.recycle_bin.list().items == ()
    assert catalog.recycle_bin.expired(datetime.now(UTC) + timedelta(days=1)) == []
    for slug in ("campus", recycled_slug(campus.id)):
        with pytest.raises(MapNotFound):
            catalog.maps.get(slug)
    with pytest.raises(JobNotFound):
        catalog.jobs.get(job.id)
    assert catalog.jobs.with_ids([job.id]) == {}
    assert catalog.jobs.claim() is None
    catalog.bases.delete("city")
    assert catalog.maps.create("campus").id != campus.id
    assert catalog.captures.clear(datetime.now(UTC) + timedelta(days=1)) == []
    assert catalog.audit.list().items == ()
    finish_purges(catalog)
    assert rows(catalog) == {"maps": 1}


def test_a_purged_drive_is_gone_for_everybody_between_two_batches(catalog, campus):
    drive = catalog.drives.get("campus", "monday")
    target = catalog.scans.target("campus", "monday", [99])
    entry = catalog.recycle_bin.put_drive("campus", "monday", purging=True)
    assert catalog.purges.remove_some(purge_of(entry), rows=10)
    with pytest.raises(NotInRecycleBin):
        catalog.recycle_bin.restore(entry.id)
    assert not catalog.drives.counted([drive])
    with pytest.raises(DriveNotFound, match="'monday' was deleted meanwhile"):
        catalog.drives.require(drive.id, "monday")
    with pytest.raises(LostRace):
        catalog.scans.add(target, [scan_record(99)])
    assert add_scans(catalog, "campus", "monday", [0]).drive_id != drive.id
    finish_purges(catalog)
    assert catalog.drives.get("campus", "monday").scans == 1


def test_another_process_goes_on_after_a_crash_between_two_batches(database_url, catalog, campus):
    entry = catalog.recycle_bin.put_map("campus", purging=True)
    assert catalog.purges.remove_some(purge_of(entry), rows=10)
    again = Catalog(database_url)
    try:
        assert again.purges.begun() == [purge_of(entry)]
        finish_purges(again)
        assert rows(again) == {}
    finally:
        again.close()
    assert not catalog.purges.remove_some(purge_of(entry))  # as one that was only slow
    catalog.purges.end(purge_of(entry))


def test_several_processes_purge_one_map_and_its_drive_at_the_same_time(
    database_url, catalog, campus
):
    [tuesday] = catalog.recycle_bin.list().items
    catalog.recycle_bin.begin_purge(tuesday.id)
    of_map = catalog.recycle_bin.put_map("campus", purging=True)
    others = [Catalog(database_url) for _ in range(3)]

    def remove(of: Catalog, purge: Purge) -> None:
        while of.purges.remove_some(purge, rows=2):
            pass
        of.purges.end(purge)

    purges = [purge_of(tuesday), purge_of(of_map)]
    try:
        with ThreadPoolExecutor(4) as pool:
            work = [
                pool.submit(remove, of, purges[number % 2])
                for number, of in enumerate([catalog, *others])
            ]
            for done in work:
                done.result()
    finally:
        for other in others:
            other.close()
    assert rows(catalog) == {}


def test_scans_are_moved_to_another_file_while_their_drive_is_purged(catalog, campus):
    drive = catalog.drives.get("campus", "monday")
    entry = catalog.recycle_bin.put_drive("campus", "monday", purging=True)

    def move() -> None:
        for number in range(20):
            with suppress(LostRace):
                scans = catalog.scans.of_drive(drive.id)[::-1]
                catalog.scans.move(drive.id, scans, f"{number}.h5")

    with ThreadPoolExecutor(1) as pool:
        moving = pool.submit(move)
        while catalog.purges.remove_some(purge_of(entry), rows=1):
            pass
        moving.result()
    catalog.purges.end(purge_of(entry))
    assert catalog.drives.slugs("campus") == ()


def test_other_writers_change_the_catalog_between_two_batches(catalog, campus):
    entry = catalog.recycle_bin.put_map("campus", purging=True)
    catalog.maps.create("dock")
    batches = 0
    while catalog.purges.remove_some(purge_of(entry), rows=20):
        catalog.maps.update("dock", description=str(batches))
        add_scans(catalog, "dock", "monday", [batches])
        batches += 1
    catalog.purges.end(purge_of(entry))
    assert rows(catalog) == {"maps": 1, "drives": 1, "scans": batches}
    assert batches > 2


def test_a_purge_is_in_the_audit_log_once(catalog, campus):
    act = Act("ab12", "delete_map", "/v1/maps/campus", "campus")
    with on_behalf(act):
        purge_map(catalog, "campus")
    assert [entry.action for entry in catalog.audit.list().items] == ["delete_map"]
    assert catalog.audit.verify().fault is None


def test_an_entry_that_is_not_purged_loses_no_row(catalog, campus):
    entry = catalog.recycle_bin.put_map("campus")
    before = rows(catalog)
    assert not catalog.purges.remove_some(purge_of(entry))
    catalog.purges.end(purge_of(entry))
    assert rows(catalog) == before
    assert catalog.purges.begun() == []
    assert catalog.recycle_bin.restore(entry.id).map_slug == "campus"


def test_a_map_of_many_drives_without_scans_takes_several_batches(catalog):
    made = catalog.maps.create("campus")
    at = datetime.now(UTC)
    drives = [
        {"id": f"{n:032x}", "map_id": made.id, "slug": f"d{n}", "created_at": at} for n in range(30)
    ]
    with catalog._database.writing() as session:
        session.execute(insert(Drive), drives)
    purge = purge_of(catalog.recycle_bin.put_map("campus", purging=True))
    with removed_rows(catalog) as counts:
        while catalog.purges.remove_some(purge, rows=500):
            pass
    assert max(counts) <= 10
    assert rows(catalog)["maps"] == 1


def test_purges_of_maps_that_had_one_name_may_end_together(catalog, database_url):
    purges = []
    for changes in range(4):
        catalog.maps.create("yard")
        for change in range(changes):
            catalog.maps.update("yard", description=f"change {change}")
        last = catalog.maps.get("yard").version
        purges.append(purge_of(catalog.recycle_bin.put_map("yard", purging=True)))
    others = [Catalog(database_url) for _ in purges]
    try:
        with ThreadPoolExecutor(len(purges)) as pool:
            ends = [
                pool.submit(of.purges.end, purge) for of, purge in zip(others, purges, strict=True)
            ]
            for end in ends:
                end.result()
    finally:
        for other in others:
            other.close()
    assert catalog.maps.create("yard").version > last
