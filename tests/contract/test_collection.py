"""What the catalog promises of retention, on every database that it supports."""

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from core.errors import InvalidParameters
from core.scans.mounting import Mounting
from core.scans.pose import Pose
from storage.catalog import Act, RevisionFacts, ScanRecord, on_behalf
from storage.errors import LostRace, MapNotFound, RevisionNotFound
from storage.retention import OwnRetention, RawScans, Retention

FACTS = RevisionFacts(encoding="harmonic", scans=2, segments=1, parameters={})
A, B, C, D = (letter * 64 for letter in "abcd")
NONE = Retention(0, 0.0)
DROP = Retention(raw_scans=RawScans.DROP)


@pytest.fixture
def catalog(catalog):
    catalog.maps.create("campus")
    return catalog


def map_id(catalog):
    return catalog.maps.get("campus").id


def add(catalog, *digests, make_live=False, **facts):
    for digest in digests:
        catalog.revisions.add(
            map_id(catalog),
            digest,
            f"{digest}.h5",
            1,
            replace(FACTS, **facts),
            make_live=make_live,
        )


def test_a_map_keeps_what_it_chose_until_it_chooses_otherwise(catalog):
    assert catalog.maps.get("campus").retention == OwnRetention()
    changed = catalog.maps.update(
        "campus", retention={"retained_revisions": 3, "raw_scans": RawScans.DROP}
    )
    assert changed.version == 2
    again = catalog.maps.update("campus", retention={"retained_for_days": 1.5})
    assert again.retention == OwnRetention(3, 1.5, RawScans.DROP)
    assert catalog.maps.get("campus") == again
    assert catalog.maps.update("campus", retention={"retained_revisions": 3}).version == 3
    none = {"retained_revisions": None, "retained_for_days": None, "raw_scans": None}
    assert catalog.maps.update("campus", retention=none).retention == OwnRetention()
    with pytest.raises(InvalidParameters):
        catalog.maps.update("campus", description="x", retention={"retained_for_days": -1.0})
    assert catalog.maps.get("campus").description == ""


def test_the_retention_of_a_replaced_revision_begins_when_it_is_replaced(catalog):
    add(catalog, A, B, C)
    later = datetime.now(UTC) + timedelta(days=10)
    assert catalog.collector.collectable(map_id(catalog), Retention(), later) == ()
    assert catalog.collector.collectable(map_id(catalog), NONE, later) == (B,)
    catalog.revisions.set_live("campus", C)
    catalog.revisions.set_live("campus", B)
    # Replaced last, the newest stays whatever the policy, and A was replaced before.
    assert catalog.collector.collectable(map_id(catalog), NONE, later) == (A,)
    assert catalog.collector.collectable(map_id(catalog), Retention(1, 0.0), later) == ()
    assert catalog.collector.collectable(map_id(catalog), Retention(0, 11.0), later) == ()
    assert catalog.collector.collectable(map_id(catalog), Retention(0, 9.0), later) == (A,)
    assert catalog.collector.collectable(map_id(catalog), Retention(0, 9.0)) == ()
    with pytest.raises(MapNotFound):
        catalog.collector.collectable("0" * 32, NONE, later)


def test_a_revision_is_collected_only_while_the_policy_does_not_keep_it(catalog):
    add(catalog, A, B, C, D)
    gone = catalog.collector.collect(map_id(catalog), B, NONE)
    assert (gone.digest, gone.file_name) == (B, f"{B}.h5")
    with pytest.raises(RevisionNotFound):
        catalog.revisions.get("campus", B)
    catalog.revisions.set_live("campus", C)  # after it was found collectable
    for kept in (B, C, D):
        with pytest.raises(LostRace), on_behalf(Act("service", "collect", "/")):
            catalog.collector.collect(map_id(catalog), kept, NONE)
    with pytest.raises(MapNotFound):
        catalog.collector.collect("0" * 32, A, NONE)
    assert not catalog.audit.list().items  # nothing was done
    with on_behalf(Act("service", "collect", "/")):
        catalog.collector.collect(map_id(catalog), A, NONE)
    assert [entry.action for entry in catalog.audit.list().items] == ["collect"]


def test_the_base_of_a_job_stays_until_the_job_has_ended(catalog):
    add(catalog, A, B, C, D)
    queued = catalog.jobs.create("campus", {"base": B})
    running = catalog.jobs.create("campus", {"base": C[:12]})
    catalog.jobs.create("campus", {"base": None})
    assert catalog.collector.collectable(map_id(catalog), NONE) == ()
    with pytest.raises(LostRace):
        catalog.collector.collect(map_id(catalog), B, NONE)
    catalog.jobs.request_cancel(queued.id)
    claimed = catalog.jobs.claim()
    assert claimed is not None
    assert claimed.id == running.id
    assert catalog.collector.collectable(map_id(catalog), NONE) == (B,)
    catalog.jobs.fail(running.id, "Odd", "")
    assert catalog.collector.collectable(map_id(catalog), NONE) == (B, C)


def test_the_revision_whose_basis_a_job_keeps_stays_until_the_job_has_ended(catalog):
    add(catalog, A, B, C)
    assert B in catalog.collector.collectable(map_id(catalog), NONE)
    queued = catalog.jobs.create("campus", {}, plan={"basis_kept_from": B})
    assert B not in catalog.collector.collectable(map_id(catalog), NONE)
    catalog.jobs.request_cancel(queued.id)
    assert B in catalog.collector.collectable(map_id(catalog), NONE)


def put(catalog, indices, chunk):
    target = catalog.scans.target("campus", "monday", indices)
    records = [
        ScanRecord(i, chunk, row, A, 100, 0, math.nan, None) for row, i in enumerate(indices)
    ]
    catalog.scans.add(target, records)
    return target.drive_id


def as_read(catalog):
    """Return a drive and its poses as they are now."""
    drive = catalog.drives.get("campus", "monday")
    return drive, catalog.poses.get(drive.id, 0, 100)


def test_returns_are_forgotten_and_the_facts_about_their_scans_stay(catalog):
    drive_id = put(catalog, [0, 1], "one.h5")
    put(catalog, [2, 3], "two.h5")
    add(catalog, A, drive_ids={"monday": drive_id})
    assert catalog.revisions.live("campus").drive_ids == {"monday": drive_id}
    target = A, *as_read(catalog)
    with pytest.raises(LostRace):  # it is open
        catalog.collector.drop_returns(*target, {0}, DROP)
    catalog.drives.close("campus", "monday")
    assert catalog.collector.drop_returns(*target, {0, 1, 2}, DROP) == {"one.h5"}
    assert catalog.collector.drop_returns(*target, set(), DROP) == set()
    drive = catalog.drives.get("campus", "monday")
    assert (drive.scans, drive.returns, drive.scans_without_returns) == (4, 400, 3)
    assert drive.size_bytes == catalog.scans.size_bytes() == 1200
    assert catalog.scans.chunks_by_drive()[drive_id] == {"two.h5"}
    assert catalog.scans.lacking_returns() == {drive_id}
    records = catalog.scans.of_drive(drive_id)
    assert [record.has_returns for record in records] == [False, False, False, True]
    assert {record.digest for record in records} == {A}
    assert catalog.collector.drop_returns(*target, {3}, DROP) == {"two.h5"}


def test_returns_stay_while_a_job_may_need_them_or_another_revision_is_live(catalog):
    drive_id = put(catalog, [0], "one.h5")
    catalog.drives.close("campus", "monday")
    add(catalog, A, B)
    drive, poses = as_read(catalog)
    target = drive, poses, {0}
    job = catalog.jobs.create("campus", {})
    assert catalog.collector.has_open_job(map_id(catalog))
    with pytest.raises(LostRace):
        catalog.collector.drop_returns(A, *target, DROP)
    catalog.jobs.request_cancel(job.id)
    assert not catalog.collector.has_open_job(map_id(catalog))
    with pytest.raises(LostRace):
        catalog.collector.drop_returns(B, *target, DROP)
    with pytest.raises(LostRace):
        catalog.collector.drop_returns(A, replace(drive, id="0" * 32), poses, {0}, DROP)
    assert catalog.scans.get(drive_id, 0).has_returns
    assert catalog.collector.drop_returns(A, *target, DROP) == {"one.h5"}


POSES = {index: Pose(float(index), 0.0, 0.0) for index in range(3)}


@pytest.mark.parametrize(
    "change",
    [
        lambda drives, _: drives.put("campus", "monday", Mounting(1.2, 0.0, 1.9), 2),
        lambda drives, _: drives.put("campus", "monday", None, 3),
        lambda _, poses: poses.put("campus", "monday", {1: Pose(1.01, 0.0, 0.0)}, {}),
        lambda _, poses: poses.put("campus", "monday", {1: None}, {}),
    ],
    ids=["its mounting", "how many become one", "a pose", "a removed pose"],
)
def test_returns_stay_if_what_their_images_depend_on_was_changed(catalog, change):
    drive_id = put(catalog, range(3), "one.h5")
    catalog.drives.put("campus", "monday", None, 2)
    catalog.poses.put("campus", "monday", POSES, {})
    catalog.drives.close("campus", "monday")
    add(catalog, A)
    before = as_read(catalog)
    change(catalog.drives, catalog.poses)
    with pytest.raises(LostRace):
        catalog.collector.drop_returns(A, *before, {0, 1, 2}, DROP)
    assert catalog.scans.get(drive_id, 0).has_returns
    assert catalog.collector.drop_returns(A, *as_read(catalog), {0, 1, 2}, DROP) == {"one.h5"}


def test_poses_of_single_scans_do_not_keep_their_returns(catalog):
    put(catalog, range(3), "one.h5")
    catalog.drives.close("campus", "monday")
    add(catalog, A)
    before = as_read(catalog)
    catalog.poses.put("campus", "monday", POSES, {})
    assert catalog.collector.drop_returns(A, *before, {0, 1, 2}, DROP) == {"one.h5"}


def test_returns_of_a_drive_in_the_recycle_bin_stay_until_it_is_restored(catalog):
    drive_id = put(catalog, [0], "one.h5")
    catalog.drives.close("campus", "monday")
    add(catalog, A)
    before = as_read(catalog)
    entry = catalog.recycle_bin.put_drive("campus", "monday")
    with pytest.raises(LostRace):
        catalog.collector.drop_returns(A, *before, {0}, DROP)
    catalog.recycle_bin.restore(entry.id)
    assert catalog.scans.get(drive_id, 0).has_returns
    assert catalog.collector.drop_returns(A, *before, {0}, DROP) == {"one.h5"}


def test_a_job_of_another_map_keeps_neither_revisions_nor_returns(catalog):
    put(catalog, [0], "one.h5")
    catalog.drives.close("campus", "monday")
    add(catalog, A, B, C)
    catalog.maps.create("depot")
    catalog.jobs.create("depot", {"base": B})
    assert not catalog.collector.has_open_job(map_id(catalog))
    assert catalog.collector.collectable(map_id(catalog), NONE) == (B,)
    assert catalog.collector.drop_returns(A, *as_read(catalog), {0}, DROP) == {"one.h5"}


def test_the_policy_that_counts_is_the_one_of_the_moment_of_removal(catalog):
    put(catalog, [0], "one.h5")
    catalog.drives.close("campus", "monday")
    add(catalog, A, B, C)
    assert catalog.collector.collectable(map_id(catalog), NONE) == (B,)
    kept = {"retained_revisions": "all", "raw_scans": RawScans.KEEP}
    catalog.maps.update("campus", retention=kept)
    with pytest.raises(LostRace):
        catalog.collector.collect(map_id(catalog), B, NONE)
    with pytest.raises(LostRace):
        catalog.collector.drop_returns(A, *as_read(catalog), {0}, DROP)
    assert catalog.collector.collectable(map_id(catalog), NONE) == ()
    catalog.maps.update("campus", retention={"retained_revisions": 0, "retained_for_days": 0.0})
    assert catalog.collector.collect(map_id(catalog), B, Retention()).digest == B


def test_a_revision_from_elsewhere_keeps_what_is_known_of_its_drives(catalog):
    add(catalog, A, drive_ids={"monday": "1" * 32})
    add(catalog, A)  # imported, the same
    assert catalog.revisions.get("campus", A).drive_ids == {"monday": "1" * 32}
    add(catalog, B)
    assert catalog.revisions.get("campus", B).drive_ids == {}
