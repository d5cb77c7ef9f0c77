"""What the catalog promises of drives and their scans, on every database that it supports."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from core.errors import InvalidParameters
from core.scans.mounting import Mounting
from core.scans.pose import Pose, PoseSource
from storage.catalog import pages, scans
from storage.catalog.models import Scan
from storage.catalog.pages import all_items
from storage.catalog.scan_poses import ScanPoses, at_indices
from storage.errors import (
    DriveNotFound,
    InvalidSlug,
    JobNotFound,
    LostRace,
    MapNotFound,
    ScanNotFound,
)
from storage.index_ranges import IndexRange
from tests.support.catalog_queries import writers_queries
from tests.support.catalog_rows import FACTS, A, add_scans, scan_record
from tests.support.purges import purge_drive, purge_map
from tests.support.sqlite_limits import allow_999_variables


class TestDrivesAndScans:
    def test_a_drive_is_made_by_its_first_scan(self, catalog):
        catalog.maps.create("campus")
        with pytest.raises(DriveNotFound, match="monday"):
            catalog.drives.get("campus", "monday")
        target = add_scans(catalog, "campus", "monday", [3])
        drive = catalog.drives.get("campus", "monday")
        assert drive.id == target.drive_id
        assert (drive.scans, drive.returns, drive.size_bytes, drive.closed) == (1, 100, 1200, False)

    def test_a_drive_has_the_mounting_that_was_put(self, catalog):
        catalog.maps.create("campus")
        mounting = Mounting(1.2, -0.4, 1.9, yaw_deg=90.0)
        made, is_new = catalog.drives.put("campus", "monday", mounting, 5)
        assert (made.mounting, made.accumulate, made.scans, is_new) == (mounting, 5, 0, True)
        assert catalog.drives.get("campus", "monday") == made
        add_scans(catalog, "campus", "monday", [3])
        changed, is_new = catalog.drives.put("campus", "monday", None, 1)
        assert (changed.id, changed.mounting, changed.scans, is_new) == (made.id, None, 1, False)
        with pytest.raises(InvalidParameters, match="accumulate is 0"):
            catalog.drives.put("campus", "monday", None, 0)
        with pytest.raises(InvalidSlug):
            catalog.drives.put("campus", "../etc", None, 1)
        with pytest.raises(MapNotFound):
            catalog.drives.put("yard", "monday", None, 1)

    def test_no_scan_is_counted_while_others_wait_to_write(self, catalog):
        catalog.maps.create("campus")
        add_scans(catalog, "campus", "monday", [3, 4])
        with writers_queries(catalog) as queries:
            assert catalog.drives.put("campus", "monday", Mounting(1.2, -0.4, 1.9), 1)[0].scans == 2
            assert catalog.drives.close("campus", "monday").present == (IndexRange(3, 4),)
        assert queries
        counting = [query for query in queries if "sum(" in query or "row_number" in query]
        assert not counting

    def test_of_many_that_make_one_drive_at_once_one_does(self, catalog):
        catalog.maps.create("campus")

        def put(count):
            return catalog.drives.put("campus", "monday", None, count)

        with ThreadPoolExecutor(6) as pool:
            made = list(pool.map(put, range(1, 13)))
        assert [is_new for _, is_new in made].count(True) == 1
        assert len({drive.id for drive, _ in made}) == 1

    def test_a_drive_has_ranges_and_gaps(self, catalog):
        catalog.maps.create("campus")
        add_scans(catalog, "campus", "monday", [9, 2, 3, 0, 4, 8])
        drive = catalog.drives.get("campus", "monday")
        assert drive.present == (IndexRange(0, 0), IndexRange(2, 4), IndexRange(8, 9))
        assert drive.gaps == (IndexRange(1, 1), IndexRange(5, 7))
        assert drive.scans == 6

    def test_counts_of_drives_with_gaps_and_without_are_each_ones_own(self, catalog):
        catalog.maps.create("campus")
        catalog.drives.put("campus", "empty", None, 1)
        for slug, indices in {"gap": [1, 3], "whole": [7, 5, 6], "other-gap": [0, 5, 6]}.items():
            add_scans(catalog, "campus", slug, indices)
        empty, *drives = catalog.drives.of_map(catalog.maps.get("campus").id)
        assert [(drive.slug, drive.scans) for drive in drives] == [
            ("gap", 2),
            ("other-gap", 3),
            ("whole", 3),
        ]
        counted = catalog.drives.counted([*reversed(drives), empty])
        assert list(counted) == list(catalog.drives.list("campus").items)
        assert [drive.present for drive in counted] == [
            (),
            (IndexRange(1, 1), IndexRange(3, 3)),
            (IndexRange(0, 0), IndexRange(5, 6)),
            (IndexRange(5, 7),),
        ]
        assert [(drive.scans, drive.returns) for drive in counted] == [
            (0, 0),
            (2, 200),
            (3, 300),
            (3, 300),
        ]
        found = catalog.drives.find("campus", "gap")
        assert found.id == drives[0].id
        purge_drive(catalog, "campus", "empty")
        assert [drive.slug for drive in catalog.drives.counted([empty, found])] == ["gap"]
        with pytest.raises(DriveNotFound, match="empty"):
            catalog.drives.find("campus", "empty")

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

    def test_a_page_ends_early_where_its_drives_have_many_gaps(self, catalog, monkeypatch):
        monkeypatch.setattr(pages, "PAGE_CHARACTERS", 3000)
        catalog.maps.create("campus")
        names = [f"drive-{number:02}" for number in range(45)]
        for name in names:
            add_scans(catalog, "campus", name, range(0, 40, 2))  # 20 ranges, and the gaps between
        add_scans(catalog, "campus", "whole", range(40))
        first = catalog.drives.list("campus", limit=1000)
        assert [drive.slug for drive in first.items] == names[:2]
        assert first.next_after == names[1]
        found = list(all_items(partial(catalog.drives.list, "campus", limit=1000)))
        assert [drive.slug for drive in found] == [*names, "whole"]
        assert {len(drive.present) for drive in found[:-1]} == {20}
        monkeypatch.setattr(pages, "PAGE_CHARACTERS", 2**20)
        assert len(catalog.drives.list("campus", limit=46).items) == 46
        assert catalog.drives.list("campus", limit=46).next_after is None

    def test_facts_come_back_as_they_were_put(self, catalog):
        catalog.maps.create("campus")
        pose = Pose(1.5, -2.25, 0.1, 0.0, 0.0, 0.6, 0.8)
        record = scan_record(2**40, pose=pose, timestamp_s=1317617735.123456)
        target = catalog.scans.target("campus", "monday", [2**40])
        catalog.scans.add(target, [record])
        assert catalog.scans.of_drive(target.drive_id) == [record]
        assert catalog.scans.get(target.drive_id, 2**40) == record

    def test_an_unknown_timestamp_is_read_back_as_unknown(self, catalog):
        catalog.maps.create("campus")
        target = add_scans(catalog, "campus", "monday", [0])
        assert math.isnan(catalog.scans.get(target.drive_id, 0).timestamp_s)
        assert catalog.scans.get(target.drive_id, 0).pose is None

    def test_a_target_has_the_scans_that_are_stored(self, catalog):
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
        purge_drive(catalog, "campus", "monday")
        with pytest.raises(LostRace):  # it was removed
            catalog.scans.add(open_drive, [scan_record(1)])
        fresh = catalog.scans.target("campus", "tuesday", [1])
        purge_map(catalog, "campus")
        with pytest.raises(LostRace):  # the map was removed
            catalog.scans.add(fresh, [scan_record(1)])

    def test_poses_for_a_drive_that_changed_meanwhile_are_not_set(self, catalog):
        catalog.maps.create("campus")
        pose = np.array([[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]])
        given = ScanPoses(np.array([0]), pose, np.array([np.nan]))
        fresh = catalog.scans.target("campus", "monday", ())
        drive = add_scans(catalog, "campus", "monday", [0])
        open_drive = catalog.scans.target("campus", "monday", ())
        with pytest.raises(LostRace):  # the drive was made
            catalog.poses.expect(fresh, given)
        catalog.drives.close("campus", "monday")
        with pytest.raises(LostRace):  # it was closed
            catalog.poses.expect(open_drive, given)
        assert catalog.scans.get(drive.drive_id, 0).pose is None
        purge_drive(catalog, "campus", "monday")
        with pytest.raises(LostRace):  # it was removed
            catalog.poses.expect(open_drive, given)

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
            catalog.poses.put("campus", "monday", {0: pose, 5: pose}, {6: 1.0})
        assert catalog.scans.get(target.drive_id, 0).pose is None
        catalog.poses.put("campus", "monday", {0: pose}, {1: 7.5})
        first, second = catalog.scans.of_drive(target.drive_id)
        assert (first.pose, second.pose, second.timestamp_s) == (pose, None, 7.5)
        catalog.poses.put("campus", "monday", {0: None}, {})
        assert catalog.scans.get(target.drive_id, 0).pose is None

    def test_poses_of_scans_far_apart_are_set_and_wait(self, catalog):
        catalog.maps.create("campus")
        stored = list(range(0, 40_000, 20))
        drive = add_scans(catalog, "campus", "monday", stored)
        scans = np.arange(0, 60_000, 10)
        poses = np.tile([0.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0], (len(scans), 1))
        poses[:, 0] = scans / 7
        poses[1] = np.nan
        given = ScanPoses(scans, poses, np.where(scans % 3, np.nan, scans / 10))
        for replaced in (0, 2000):
            target = catalog.scans.target("campus", "monday", ())
            put = catalog.poses.expect(target, given, partial=True)
            assert (put.set, put.replaced, put.forgotten, put.waiting) == (2000, replaced, 0, 3999)
            poses[2:, 1] += 1.0
            poses[0, 1] += 1.0
        add_scans(catalog, "campus", "monday", [10, 30, 59_990])
        found = {record.index: record for record in catalog.scans.of_drive(drive.drive_id)}
        assert found[10].pose is None
        assert found[30].pose == Pose(30 / 7, 3.0, 3.0)
        assert (found[30].timestamp_s, found[20].pose) == (3.0, Pose(20 / 7, 3.0, 3.0))
        assert math.isnan(found[59_990].timestamp_s)
        assert catalog.drives.get("campus", "monday").expected_poses == 3997

    @pytest.mark.parametrize("given", ["a pose", "a file", "a scan with a pose"])
    def test_given_poses_take_the_place_of_all_computed_ones(self, catalog, given):
        catalog.maps.create("campus")
        add_scans(catalog, "campus", "monday", range(4))
        drive = catalog.drives.get("campus", "monday")
        assert drive.pose_source == PoseSource.GIVEN
        poses = np.array([Pose(float(at), 2.0, 3.0).as_tuple() for at in range(4)])
        sigmas = np.array([[0.0, 0.0], [0.1, 0.2], [0.2, 0.3], [np.nan, np.nan]])
        computed = ScanPoses(np.arange(4), poses, np.full(4, np.nan), sigmas)
        made = {"version": "1", "closures": 2}
        lacking = replace(computed, scans=np.arange(1, 5))
        assert not catalog.poses.set_computed(drive.id, lacking, made)
        assert not catalog.poses.set_computed("gone", computed, made)
        assert catalog.poses.set_computed(drive.id, computed.only(poses[:, 0] < 2), made)
        assert catalog.drives.get("campus", "monday").scans_with_pose == 2
        assert catalog.poses.set_computed(drive.id, computed, made)
        found = catalog.poses.get(drive.id, 0, 10)
        assert np.array_equal(found.poses, poses)
        assert np.array_equal(found.sigmas, sigmas, equal_nan=True)
        drive = catalog.drives.get("campus", "monday")
        assert (drive.pose_source, drive.odometry, drive.scans_with_pose) == ("odometry", made, 4)
        add_scans(catalog, "campus", "monday", [4])
        assert catalog.drives.get("campus", "monday").odometry == made
        if given == "a pose":
            catalog.poses.put("campus", "monday", {1: Pose(7.0, 7.0, 7.0)}, {})
        elif given == "a file":
            target = catalog.scans.target("campus", "monday", [])
            put = catalog.poses.expect(target, computed, partial=True)
            assert (put.set, put.replaced, put.forgotten) == (4, 0, 0)
        else:
            target = catalog.scans.target("campus", "monday", [9])
            record = replace(scan_record(9), pose=Pose(7.0, 7.0, 7.0))
            catalog.scans.add(target, [record])
        drive = catalog.drives.get("campus", "monday")
        assert (drive.pose_source, drive.odometry) == (PoseSource.GIVEN, None)
        assert drive.scans_with_pose == (4 if given == "a file" else 1)
        assert np.isnan(catalog.poses.get(drive.id, 0, 10).sigmas).all()
        assert not catalog.poses.set_computed(drive.id, computed, made)

    def test_a_deleted_drive_gets_no_computed_poses(self, catalog):
        catalog.maps.create("campus")
        add_scans(catalog, "campus", "monday", [0])
        drive = catalog.drives.get("campus", "monday")
        pose = ScanPoses(np.arange(1), np.eye(7)[-1:], np.full(1, np.nan), np.zeros((1, 2)))
        entry = catalog.recycle_bin.put_drive("campus", "monday")
        assert not catalog.poses.set_computed(drive.id, pose, {})
        catalog.recycle_bin.restore(entry.id)
        assert catalog.poses.set_computed(drive.id, pose, {})

    def test_computed_poses_are_in_the_audit_log_once_they_are_stored(self, catalog):
        catalog.maps.create("campus")
        add_scans(catalog, "campus", "monday", [0])
        drive = catalog.drives.get("campus", "monday")
        pose = ScanPoses(np.arange(1), np.eye(7)[-1:], np.full(1, np.nan), np.zeros((1, 2)))
        assert not catalog.poses.set_computed(drive.id, replace(pose, scans=np.arange(1, 2)), {})
        assert catalog.audit.list().items == ()
        assert catalog.poses.set_computed(drive.id, pose, {})
        [entry] = catalog.audit.list().items
        assert (entry.key_id, entry.action, entry.map_slug) == (
            "service",
            "compute_poses",
            "campus",
        )
        assert entry.subject == "/v1/maps/campus/drives/monday/poses"
        assert entry.detail == "poses of 1 scan"

    def test_a_drive_is_not_read_from_end_to_end_for_the_scans_at_its_ends(self, catalog):
        clauses = [str(clause) for clause in at_indices(Scan.index, [0, 10**6])]
        assert len(clauses) == 1
        assert " IN " in clauses[0]
        assert len(list(at_indices(Scan.index, range(0, 10_000, 10)))) == 2
        assert "BETWEEN" in str(next(at_indices(Scan.index, [3, 4, 7])))

    def test_of_many_files_those_without_a_scan_are_named(self, catalog, monkeypatch):
        monkeypatch.setattr(scans, "chunks_of", None)  # takes long in a drive of many files
        allow_999_variables(catalog)
        catalog.maps.create("campus")
        indices = range(2200)
        target = catalog.scans.target("campus", "monday", indices)
        records = [scan_record(index, f"{index // 2}.h5", row=index % 2) for index in indices]
        catalog.scans.add(target, records)
        moved = [one for one in records if one.index not in {3, 2190}]
        emptied = catalog.scans.move(target.drive_id, moved, "big.h5")
        assert {f"{index}.h5" for index in range(1100)} - emptied == {"1.h5", "1095.h5"}

    def test_drives_of_a_map_are_counted_however_many_they_are(self, catalog):
        allow_999_variables(catalog)
        campus = catalog.maps.create("campus")
        slugs = [f"drive-{number:04}" for number in range(1001)]
        for slug in slugs:
            catalog.drives.put("campus", slug, None, 1)
        add_scans(catalog, "campus", slugs[-1], [2, 5])
        filled = catalog.drives.of_map(campus.id)
        assert [drive.slug for drive in filled if drive.scans] == slugs[-1:]
        assert [len(drive.present) for drive in catalog.drives.counted(filled)] == [0] * 1000 + [2]
        assert len(catalog.drives.list("campus", limit=1000).items) == 1000

    def test_moved_scans_are_found_in_the_new_chunk(self, catalog):
        catalog.maps.create("campus")
        target = add_scans(catalog, "campus", "monday", [0, 1], "a.h5")
        add_scans(catalog, "campus", "monday", [2], "b.h5")
        records = catalog.scans.of_drive(target.drive_id)
        assert catalog.scans.move(target.drive_id, records[1:], "big.h5") == {"b.h5"}
        places = [(r.chunk, r.row) for r in catalog.scans.of_drive(target.drive_id)]
        assert places == [("a.h5", 0), ("big.h5", 0), ("big.h5", 1)]
        assert catalog.scans.chunks_by_drive() == {target.drive_id: {"a.h5", "big.h5"}}
        with pytest.raises(LostRace):
            catalog.scans.move(target.drive_id, records[1:], "late.h5")

    def test_a_deleted_map_takes_all_it_had_with_it(self, catalog):
        catalog.maps.create("campus")
        target = add_scans(catalog, "campus", "monday", [0])
        catalog.revisions.add(catalog.maps.get("campus").id, A, "a.h5", 10, FACTS)
        job = catalog.jobs.create("campus", {})
        purge_map(catalog, "campus")
        assert catalog.scans.of_drive(target.drive_id) == []
        assert catalog.revisions.files(target.map_id) == catalog.revisions.files_by_map() == {}
        assert catalog.drives.by_map() == {}
        with pytest.raises(JobNotFound):
            catalog.jobs.get(job.id)
