"""Drives in the store: what was acknowledged is there, and nothing else."""

import contextlib
import dataclasses
import errno
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np
import pytest

from core.errors import InvalidParameters
from core.scans.drive import Drive
from core.scans.pose import Pose
from storage.catalog import NewCapture
from storage.errors import (
    CorruptFile,
    DriveClosed,
    DriveNotFound,
    InvalidSlug,
    LostRace,
    MapNotFound,
    ScanConflict,
    ScanNotFound,
    StorageFull,
    StorageReadOnly,
)
from storage.files.drive_chunks import scan_digest
from storage.retention import Retention
from storage.store import Store
from tests.support.catalog_queries import catalog_queries
from tests.support.catalog_rows import stored_scans
from tests.support.small_scans import sample_scan

pytestmark = pytest.mark.slow


def files(store):
    return sorted(path.name for path in store.layout.maps.rglob("*") if path.is_file())


def length_of(drive: Drive) -> int:
    """Take what the method takes; mypy then holds the store to the protocol."""
    return len(drive)


def put_many(store, indices, drive="monday"):
    for index in indices:
        store.drives.put_scan("campus", drive, index, sample_scan(index))


def assert_stored(store, indices, drive="monday"):
    for index in indices:
        scan = store.drives.read_scan("campus", drive, index)
        assert scan.points_m.tobytes() == sample_scan(index).points_m.tobytes()


class TestPutting:
    def test_the_same_content_again_changes_nothing(self, store):
        first = store.drives.put_scan("campus", "monday", 3, sample_scan(3))
        before = files(store)
        again = store.drives.put_scan("campus", "monday", 3, sample_scan(3))
        assert (first.created, again.created) == (True, False)
        assert again.record == first.record
        assert files(store) == before

    def test_other_content_is_rejected_naming_both_digests_and_the_way_out(self, store):
        store.drives.put_scan("campus", "monday", 3, sample_scan(3))
        before = files(store)
        with pytest.raises(ScanConflict) as rejected:
            store.drives.put_scan("campus", "monday", 3, sample_scan(4))
        for seed in (3, 4):
            assert scan_digest(sample_scan(seed).points_m) in str(rejected.value)
        assert "only with its drive" in str(rejected.value)
        assert files(store) == before
        assert_stored(store, [3])

    def test_a_scan_is_read_back_with_all_its_facts(self, store):
        put = dataclasses.replace(
            sample_scan(1),
            timestamp_s=1317617735.25,
            pose=Pose(1.0, 2.0, 3.0),
            dropped_returns=17,
        )
        store.drives.put_scan("campus", "monday", 5, put)
        back = store.drives.read_scan("campus", "monday", 5)
        assert (back.timestamp_s, back.pose, back.dropped_returns) == (
            1317617735.25,
            Pose(1.0, 2.0, 3.0),
            17,
        )

    def test_many_scans_share_one_chunk_and_what_is_there_is_left_out(self, store):
        put_many(store, [1])
        results = store.drives.put_scans(
            "campus", "monday", [(index, sample_scan(index)) for index in (2, 1, 0)]
        )
        assert [(r.record.index, r.created) for r in results] == [(2, True), (1, False), (0, True)]
        assert len(files(store)) == 2
        assert_stored(store, [0, 1, 2])

    def test_one_conflict_among_many_stores_none(self, store):
        put_many(store, [1])
        with pytest.raises(ScanConflict):
            store.drives.put_scans("campus", "monday", [(0, sample_scan(0)), (1, sample_scan(9))])
        assert store.drives.get("campus", "monday").scans == 1
        assert len(files(store)) == 1

    def test_an_empty_put_stores_nothing(self, store):
        assert store.drives.put_scans("campus", "monday", []) == []
        with pytest.raises(DriveNotFound):
            store.drives.get("campus", "monday")

    @pytest.mark.parametrize("indices", [[-1], [2**53], [4, 4]])
    def test_indices_that_cannot_be_are_rejected(self, store, indices):
        with pytest.raises(InvalidParameters):
            store.drives.put_scans("campus", "monday", [(i, sample_scan(1)) for i in indices])
        assert files(store) == []

    def test_names_are_checked(self, store):
        with pytest.raises(MapNotFound):
            store.drives.put_scan("nowhere", "monday", 0, sample_scan(0))
        with pytest.raises(InvalidSlug):
            store.drives.put_scan("campus", "../monday", 0, sample_scan(0))
        assert files(store) == []

    def test_a_purged_drive_can_be_made_again(self, store):
        put_many(store, [0, 1])
        store.drives.purge("campus", "monday")
        assert files(store) == []
        with pytest.raises(DriveNotFound):
            store.drives.read_scan("campus", "monday", 0)
        store.drives.put_scan("campus", "monday", 0, sample_scan(5))
        assert store.drives.get("campus", "monday").scans == 1


class TestRaces:
    def test_threads_that_put_different_scans_all_succeed(self, store):
        with ThreadPoolExecutor(8) as pool:
            list(pool.map(lambda index: put_many(store, [index]), range(40)))
        assert store.drives.get("campus", "monday").scans == 40
        assert len(files(store)) == 40
        assert_stored(store, range(40))

    def test_of_threads_that_put_the_same_scan_one_creates_it(self, store):
        def put(_):
            return store.drives.put_scan("campus", "monday", 7, sample_scan(7)).created

        with ThreadPoolExecutor(8) as pool:
            created = list(pool.map(put, range(8)))
        assert sorted(created) == [False] * 7 + [True]
        assert len(files(store)) == 1

    def test_of_threads_that_put_different_content_at_one_index_one_wins(self, store):
        def put(seed):
            try:
                return store.drives.put_scan("campus", "monday", 7, sample_scan(seed)).created
            except ScanConflict:
                return False

        with ThreadPoolExecutor(8) as pool:
            created = list(pool.map(put, range(8)))
        assert sum(created) == 1
        stored = store.drives.read_scan("campus", "monday", 7)
        assert scan_digest(stored.points_m) == scan_digest(
            sample_scan(created.index(True)).points_m
        )
        assert len(files(store)) == 1

    @pytest.mark.parametrize("how", ["delete", "purge"])
    def test_a_drive_that_goes_while_a_scan_is_put_holds_the_scan_or_is_gone(self, store, how):
        def put_and_delete(index):
            put_many(store, [index])
            if index % 5 == 0:
                with contextlib.suppress(DriveNotFound):
                    getattr(store.drives, how)("campus", "monday")

        with ThreadPoolExecutor(8) as pool:
            list(pool.map(put_and_delete, range(60)))
        put_many(store, [99])
        present = [record.index for record in stored_scans(store, "campus", "monday")]
        assert_stored(store, present)
        in_bin = [
            record.index
            for entry in store.recycle_bin.list().items
            for record in store.catalog.scans.of_drive(entry.id)
        ]
        assert len(files(store)) == len(present) + len(in_bin)
        if how == "delete":
            assert sorted(present + in_bin) == [*range(60), 99]

    def test_scans_can_be_read_while_their_drive_is_packed(self, store):
        put_many(store, range(30))
        drive = store.drives.open("campus", "monday")
        with ThreadPoolExecutor(4) as pool:
            closing = pool.submit(store.drives.close, "campus", "monday")
            reads = [pool.submit(drive.scan, position % 30) for position in range(120)]
            closing.result()
            for position, read in enumerate(reads):
                expected = sample_scan(position % 30)
                assert read.result().points_m.tobytes() == expected.points_m.tobytes()


class TestAFullOrReadOnlyDisk:
    @pytest.mark.parametrize(
        ("number", "named"), [(errno.ENOSPC, StorageFull), (errno.EROFS, StorageReadOnly)]
    )
    @pytest.mark.parametrize("call", ["fsync", "rename", "mkdir"])
    def test_a_scan_that_cannot_be_written_changes_nothing(
        self, store, monkeypatch, number, named, call
    ):
        def fail(*_args, **_kwargs):
            raise OSError(number, os.strerror(number))

        with monkeypatch.context() as patch:
            patch.setattr(os, call, fail)
            with pytest.raises(named):
                put_many(store, [0])
        assert files(store) == []
        with pytest.raises(DriveNotFound):
            store.drives.get("campus", "monday")
        put_many(store, [0])
        assert_stored(store, [0])

    def test_a_full_disk_while_the_row_is_committed_leaves_no_file(self, store):
        put_many(store, [0])
        database = store.catalog._database
        with database.engine.connect() as connection:
            pages = connection.exec_driver_sql("PRAGMA page_count").scalar()
        # SQLite itself then reports that the database is full, as it does for the disk.
        with database.reading() as session:
            session.connection().exec_driver_sql(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(StorageFull):
            put_many(store, range(1, 200))
        stored = store.drives.get("campus", "monday").scans
        assert len(files(store)) == stored
        assert_stored(store, range(stored))


class TestReading:
    def test_an_index_that_is_not_there_is_not_found(self, store):
        put_many(store, [0])
        with pytest.raises(ScanNotFound):
            store.drives.read_scan("campus", "monday", 1)

    def test_no_scans_are_counted_to_read_one_or_to_begin_a_capture(self, store):
        put_many(store, range(3))
        with catalog_queries(store) as queries:
            store.drives.read_scan("campus", "monday", 1)
            capture = NewCapture(drive="monday", files=(("a.bag", 32),), part_bytes=16)
            store.captures.create("campus", capture)
        assert not [query for query in queries if "scans" in query and "count(" in query]

    def test_a_changed_byte_is_found(self, store):
        put_many(store, [0])
        (chunk,) = store.layout.maps.rglob("*.h5")
        with h5py.File(chunk, "r+") as file:
            file["points_m"][3, 1] += 1.0
        with pytest.raises(CorruptFile, match="digest"):
            store.drives.read_scan("campus", "monday", 0)

    def test_a_file_that_cannot_be_read_is_named_with_its_scan_and_drive(self, store):
        put_many(store, [0])
        (chunk,) = store.layout.maps.rglob("*.h5")
        chunk.write_bytes(bytes(2000))
        with pytest.raises(CorruptFile, match=r"^scan 0 of drive 'monday': .* cannot be read: "):
            store.drives.read_scan("campus", "monday", 0)

    def test_a_lost_file_is_found(self, store):
        put_many(store, [0])
        (chunk,) = store.layout.maps.rglob("*.h5")
        chunk.unlink()
        lost = (
            r"the file of scan 0 of drive 'monday' is gone: .*; restore it, or send the scan again"
        )
        with pytest.raises(CorruptFile, match=lost):
            store.drives.read_scan("campus", "monday", 0)

    def test_an_open_drive_counts_positions_and_knows_the_indices(self, store):
        put_many(store, [4, 0, 9])
        store.drives.put_poses("campus", "monday", {4: Pose(1.0, 2.0, 3.0)}, {9: 5.5})
        drive = store.drives.open("campus", "monday")
        assert length_of(drive) == 3
        assert drive.name == "monday"
        assert drive.scan_index.tolist() == [0, 4, 9]
        assert drive.poses[1, :3].tolist() == [1.0, 2.0, 3.0]
        assert np.isnan(drive.poses[[0, 2]]).all()
        assert np.nan_to_num(drive.timestamp_s).tolist() == [0.0, 0.0, 5.5]
        assert drive.digests[1] == scan_digest(sample_scan(4).points_m)
        assert drive.scan(1).points_m.tobytes() == sample_scan(4).points_m.tobytes()
        assert drive.scan(1).pose == Pose(1.0, 2.0, 3.0)


class TestClosing:
    def test_a_closed_drive_takes_no_new_scan_but_an_old_one_again(self, store):
        put_many(store, [0, 1])
        assert store.drives.close("campus", "monday").closed
        with pytest.raises(DriveClosed, match="no scan 2"):
            put_many(store, [2])
        with pytest.raises(ScanConflict):
            store.drives.put_scan("campus", "monday", 0, sample_scan(9))
        assert not store.drives.put_scan("campus", "monday", 0, sample_scan(0)).created
        assert len(files(store)) == 1

    def test_small_chunks_become_few_and_closing_again_does_nothing(self, store, monkeypatch):
        monkeypatch.setattr("storage.store.compaction._CHUNK_BYTES", 4 * 20 * 12)
        put_many(store, range(10))
        store.drives.close("campus", "monday")
        packed = files(store)
        assert len(packed) == 3
        assert_stored(store, range(10))
        store.drives.close("campus", "monday")
        assert files(store) == packed

    @pytest.mark.parametrize("how", ["gone", "damaged"])
    def test_a_damaged_scan_keeps_no_other_from_being_packed(self, store, monkeypatch, caplog, how):
        monkeypatch.setattr("storage.store.compaction._CHUNK_BYTES", 4 * 20 * 12)
        put_many(store, range(6))
        drive = store.drives.find("campus", "monday")
        chunks = store.layout.chunks(drive.map_id, drive.id)
        path = chunks / store.catalog.scans.get(drive.id, 1).chunk
        whole = path.read_bytes()
        path.unlink()
        if how == "damaged":
            path.write_bytes(whole.replace(sample_scan(1).points_m.tobytes(), bytes(240)))
        assert store.drives.close("campus", "monday").closed
        assert "1 scan not packed: " in caplog.text
        packed = {path.name for path in chunks.iterdir()} - {path.name}
        assert len(packed) == 2
        assert_stored(store, [0, *range(2, 6)])
        with pytest.raises(CorruptFile):
            store.drives.read_scan("campus", "monday", 1)
        store.drives.close("campus", "monday")
        assert {path.name for path in chunks.iterdir()} - {path.name} == packed
        path.write_bytes(whole)
        store.drives.close("campus", "monday")
        assert len(list(chunks.iterdir())) == 2
        assert_stored(store, range(6))

    @pytest.mark.parametrize("step", ["write_chunk", "move", "unlink"])
    def test_a_crash_between_the_steps_of_packing_loses_nothing(self, store, monkeypatch, step):
        class Crash(Exception):
            pass

        def crash(*_args, **_kwargs):
            raise Crash

        put_many(store, range(6))
        with monkeypatch.context() as patch:
            if step == "write_chunk":
                patch.setattr("storage.store.compaction.write_chunk", crash)
            elif step == "move":
                patch.setattr(store.catalog.scans, "move", crash)
            else:
                patch.setattr(Path, "unlink", crash)
            with pytest.raises(Crash):
                store.drives.close("campus", "monday")
        assert store.drives.get("campus", "monday").closed
        assert_stored(store, range(6))
        store.recover()
        assert_stored(store, range(6))
        store.drives.close("campus", "monday")
        assert len(files(store)) == 1
        assert_stored(store, range(6))

    def test_a_damaged_scan_is_not_packed_as_if_it_were_whole(self, store):
        put_many(store, [0, 1])
        chunk = sorted(store.layout.maps.rglob("*.h5"))[0]
        with h5py.File(chunk, "r+") as file:
            file["points_m"][0, 0] += 1.0
        before = files(store)
        store.drives.close("campus", "monday")
        assert files(store) == before


class TestStarting:
    def test_files_without_a_catalog_row_are_removed_and_the_rest_stays(self, store):
        put_many(store, [0, 1])
        (store.layout.maps / ("0" * 32) / "drives").mkdir(parents=True)
        chunks = next(store.layout.maps.rglob("*.h5")).parent
        shutil.copy(next(chunks.iterdir()), chunks / "orphan.h5")
        (chunks / ".half.h5.0011.part").write_bytes(b"half")
        (chunks.parent / "images").mkdir()
        (chunks.parent / "images" / "cache.h5").write_bytes(b"cache")
        (chunks.parent.parent / ("f" * 32)).mkdir()
        store.recover()
        assert not (store.layout.maps / ("0" * 32)).exists()
        assert not (chunks.parent.parent / ("f" * 32)).exists()
        assert not (chunks / "orphan.h5").exists()
        assert (chunks.parent / "images" / "cache.h5").exists()
        assert len(files(store)) == 3
        assert_stored(store, [0, 1])

    def test_a_purged_map_leaves_no_file(self, store):
        put_many(store, [0])
        store.maps.purge("campus")
        assert list(store.layout.maps.iterdir()) == []

    def test_a_second_store_reads_what_the_first_wrote(self, store):
        put_many(store, [0, 1])
        with Store(store.layout.data_dir) as second:
            assert_stored(second, [0, 1])
            put_many(second, [2])
        assert_stored(store, [2])


@pytest.mark.parametrize("how", ["gone", "damaged"])
def test_a_scan_whose_file_was_lost_is_put_back_by_putting_it_again(tmp_path, how):
    with Store(tmp_path) as store:
        store.maps.create("campus")
        scans = [(index, sample_scan(index)) for index in range(3)]
        store.drives.put_scans("campus", "monday", scans)
        store.drives.put_scan("campus", "monday", 7, sample_scan(7))
        path = max(tmp_path.rglob("chunks/*.h5"), key=lambda path: path.stat().st_size)
        if how == "gone":
            path.unlink()
        else:
            content = bytearray(path.read_bytes())
            at = content.index(scans[1][1].points_m.tobytes())
            content[at + 1] ^= 1
            path.write_bytes(content)
        assert not store.drives.put_scans("campus", "monday", scans)[1].created
        for index, scan in scans:
            assert np.array_equal(
                store.drives.read_scan("campus", "monday", index).points_m, scan.points_m
            )
        with pytest.raises(ScanConflict):
            store.drives.put_scan("campus", "monday", 1, sample_scan(9))


def test_no_returns_are_dropped_whose_images_are_gone(store, tmp_path):
    put_many(store, range(3))
    drive = store.drives.open("campus", "monday")
    with pytest.raises(LostRace, match="removed the images"):
        store.drives.drop_returns("a" * 64, drive, tmp_path / "gone.h5", {0, 1}, Retention())
    assert store.drives.open("campus", "monday").has_returns.all()


def test_a_scan_whose_file_is_packed_while_it_is_read_is_read_from_the_new_one(store, monkeypatch):
    for index in range(2):
        put_many(store, [index])
    drive = store.drives.open("campus", "monday")
    find = store.catalog.scans.get
    before = [find(drive.id, 0)]
    store.drives.close("campus", "monday")
    assert find(drive.id, 0).chunk != before[0].chunk
    monkeypatch.setattr(
        store.catalog.scans, "get", lambda *which: before.pop() if before else find(*which)
    )
    np.testing.assert_array_equal(drive.scan(0).points_m, sample_scan(0).points_m)
    assert before == []
