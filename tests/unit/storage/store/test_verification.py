"""Every file is held against its digest; a repair sets aside and removes no only copy."""

import errno
import functools
import logging
import os
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import pytest

from core.projection.imager import Imager
from core.projection.reducer import Reducer
from core.scans.sensor import AngularGrid
from storage.catalog import RevisionFacts
from storage.errors import CorruptFile, DataDirInUse
from storage.files.image_file import image_file_name, write_image_file
from storage.files.map_file import write_map
from storage.store import Store
from storage.store.leftovers import ORPHANS_KEPT_DAYS
from storage.store.verification import Condition, verify
from tests.support.catalog_rows import stored_scans
from tests.support.samples import sample_map
from tests.support.small_scans import sample_scan

pytestmark = pytest.mark.slow

FACTS = RevisionFacts(encoding="paper", scans=24, segments=3, parameters={})


@pytest.fixture
def filled(store):
    """Ten scans in one file and two in two, images of the former, and two revisions."""
    for index in range(10):
        store.drives.put_scan("campus", "monday", index, sample_scan(index, 200))
    store.drives.close("campus", "monday")
    for index in range(2):
        store.drives.put_scan("campus", "tuesday", index, sample_scan(index, 200))
    map_id = store.maps.get("campus").id
    for seed in range(2):
        made, _ = sample_map(seed=seed)
        store.revisions.add(map_id, made.revision, lambda path, m=made: write_map(path, m), FACTS)
    drive = store.drives.open("campus", "monday")
    imager = Imager(AngularGrid(), Reducer.LAST)
    folder = store.drives.images_folder(drive.record)
    write_image_file(folder / image_file_name(imager, "0" * 64), drive, imager)
    return store


def flip(path, at):
    content = bytearray(path.read_bytes())
    content[content.index(at) + len(at) // 2] ^= 1
    path.write_bytes(content)


def packed(store):
    """Return the file that has all scans of monday."""
    [name] = {record.chunk for record in stored_scans(store, "campus", "monday")}
    return next(store.layout.maps.rglob(name))


def contents(store):
    """Return every file that has numbers in it, by its content."""
    return {path.read_bytes() for path in store.layout.data_dir.rglob("*.h5")}


def of(verification, condition):
    return [finding for finding in verification.findings if finding.condition is condition]


def test_a_sound_store_is_whole_and_every_file_of_it_is_read(filled):
    found = verify(filled)
    assert (found.files, found.findings, found.is_whole) == (1 + 2 + 2 + 1, (), True)


def test_a_damaged_row_is_set_aside_and_all_other_scans_are_read(filled):
    path = packed(filled)
    flip(path, sample_scan(3, 200).points_m.tobytes())
    damaged = path.read_bytes()
    [finding] = verify(filled).findings
    assert (finding.condition, finding.path.endswith(path.name)) == (Condition.DAMAGED, True)
    assert finding.described == "map campus, drive monday, scan 3"
    assert path.exists()
    assert not filled.layout.damaged.exists()
    found = verify(filled, repair=True)
    assert not found.is_whole
    assert "9 good scans have a new file" in found.findings[0].done
    [aside] = filled.layout.damaged.rglob("*.h5")
    assert aside.read_bytes() == damaged
    for index in range(10):
        if index == 3:
            with pytest.raises(CorruptFile, match="is gone"):
                filled.drives.read_scan("campus", "monday", index)
        else:
            read = filled.drives.read_scan("campus", "monday", index)
            assert read.points_m.tobytes() == sample_scan(index, 200).points_m.tobytes()
    assert [finding.condition for finding in verify(filled).findings] == [Condition.MISSING]


def test_a_damaged_revision_is_set_aside_and_the_other_one_stays(filled):
    live = filled.revisions.live("campus")
    path = filled.revisions.path_of(live)
    with h5py.File(path, "r+") as file:
        file["signatures"][0] += 1.0
    found = verify(filled, repair=True)
    [finding] = found.findings
    assert finding.done.startswith("moved to damaged/")
    assert not path.exists()
    assert not found.is_whole
    assert [f.path for f in verify(filled).findings] == [finding.path]


@pytest.mark.parametrize("how", ["lost", "damaged"])
def test_a_revision_that_was_lost_or_damaged_is_put_back_by_adding_it_again(filled, how):
    live = filled.revisions.live("campus")
    path = filled.revisions.path_of(live)
    if how == "lost":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:-100])
    for seed in range(2):
        made, _ = sample_map(seed=seed)
        write = functools.partial(write_map, tensor_map=made)
        filled.revisions.add(live.map_id, made.revision, write, FACTS)
    assert path.exists()
    assert len(list(path.parent.iterdir())) == 2
    assert verify(filled).findings == ()


def test_damaged_images_are_removed_if_a_build_can_make_them_again_and_else_kept(filled):
    [path] = filled.layout.maps.rglob("images/*.h5")
    with h5py.File(path, "r+") as file:
        at = file["images"].id.get_chunk_info(0).byte_offset
    content = bytearray(path.read_bytes())
    content[at + 100] ^= 1
    path.write_bytes(content)
    assert not verify(filled).is_whole
    copied = filled.layout.data_dir.parent / "copy"
    shutil.copytree(filled.layout.data_dir, copied)
    found = verify(filled, repair=True)
    assert found.is_whole
    assert found.findings[0].done == "removed: a build makes it again"
    assert not path.exists()
    assert verify(filled).findings == ()
    with Store(copied) as store:
        drop_all_returns(store)
        assert not verify(store, repair=True).is_whole
        [aside] = store.layout.damaged.rglob("images/*.h5")
        assert aside.read_bytes() == content


def drop_all_returns(store):
    drive = store.drives.get("campus", "monday")
    with store.catalog._database.writing() as session:
        from storage.catalog.models import Scan as Row

        for row in session.query(Row).where(Row.drive_id == drive.id):
            row.chunk, row.row = "", 0


def test_a_missing_file_is_reported_and_a_leftover_is_no_loss(filled):
    chunk = next(filled.layout.maps.rglob("chunks/*.h5"))
    shutil.move(chunk, chunk.with_name("0" * 32 + ".h5"))
    part = chunk.with_name(".x.h5.0123.part")
    part.touch()
    found = verify(filled)
    assert [finding.path for finding in of(found, Condition.MISSING)] == [
        str(chunk.relative_to(filled.layout.data_dir))
    ]
    assert {finding.what for finding in of(found, Condition.LEFT_OVER)} == {
        "half-written",
        "no row names it",
    }
    assert not any(finding.is_loss for finding in of(found, Condition.LEFT_OVER))
    assert part.exists()


def test_beside_a_server_nothing_is_repaired_and_what_is_young_is_in_use(filled):
    data = filled.layout.data_dir
    young, old = (data / "maps" / name for name in (".young.1.part", ".old.1.part"))
    for path in (young, old):
        path.touch()
    os.utime(old, (0, 0))
    filled.recover()  # it is the server now, and swept
    for path in (young, old):
        path.touch()
    os.utime(old, (0, 0))
    with Store(data) as beside:
        with pytest.raises(DataDirInUse):
            verify(beside, repair=True)
        assert [finding.path for finding in verify(beside).findings] == ["maps/.old.1.part"]
    assert young.exists()


@pytest.mark.parametrize("within", [".", "chunks", "images"])
def test_a_drive_that_is_purged_while_its_folder_is_listed_is_no_fault(filled, monkeypatch, within):
    drive = filled.drives.find("campus", "monday")
    listed = filled.layout.drive(drive.map_id, drive.id) / within
    purged: set[str] = set()

    def listing(original, path="."):
        if not purged and not isinstance(path, int) and Path(path) == listed:
            purged.add(filled.drives.find("campus", "monday").id)
            filled.drives.purge("campus", "monday")
        return original(path)

    for name in ("scandir", "listdir"):
        monkeypatch.setattr(os, name, functools.partial(listing, getattr(os, name)))
    assert verify(filled).findings == ()
    assert purged == {drive.id}


@pytest.mark.parametrize("name", ["chunks", "images", "revisions", "drives", "bases", "orphans"])
def test_a_folder_that_the_disk_cannot_list_ends_neither_a_start_nor_a_verification(
    filled, monkeypatch, caplog, name
):
    for top in (filled.layout.bases, filled.layout.orphans):
        top.mkdir()
    data_dir, folder = filled.layout.data_dir, next(filled.layout.data_dir.rglob(name))
    filled.close()

    def listing(original, path="."):
        if not isinstance(path, int) and Path(path) == folder:
            raise OSError(errno.EIO, "Input/output error", str(folder))
        return original(path)

    for lists in ("scandir", "listdir"):
        monkeypatch.setattr(os, lists, functools.partial(listing, getattr(os, lists)))
    with Store.serving(data_dir) as started:
        assert started.drives.read_scan("campus", "monday", 3).points_m.size
        assert verify(started).is_whole
    warned = [record.getMessage() for record in caplog.records]
    assert all(one.startswith(f"{folder} cannot be listed") for one in warned)
    assert bool(warned) == (name != "images")  # of which none is left over


def test_a_repair_removes_nothing_that_may_be_an_only_copy(filled):
    flip(packed(filled), sample_scan(3, 200).points_m.tobytes())
    stray = filled.layout.maps / "stray.h5"
    stray.write_bytes(b"who knows")
    with h5py.File(filled.revisions.path_of(filled.revisions.live("campus")), "r+") as file:
        file["signatures"][0] += 1.0
    before = contents(filled)
    verify(filled, repair=True)
    assert before <= contents(filled)


def test_orphans_are_kept_for_their_days_and_what_older_versions_left_from_now_on(filled):
    orphans = filled.layout.orphans
    today = datetime.now(UTC).date()
    days = {name: today - timedelta(days=age) for name, age in (
        ("over", ORPHANS_KEPT_DAYS + 1), ("last", ORPHANS_KEPT_DAYS), ("today", 0))}  # fmt: skip
    for day in days.values():
        (orphans / str(day) / "maps").mkdir(parents=True)
    (orphans / "maps" / "old").mkdir(parents=True)
    (orphans / "maps" / "old" / "x.h5").write_bytes(b"of an older version")
    filled.recover()
    assert sorted(path.name for path in orphans.iterdir()) == sorted(
        str(days[name]) for name in ("last", "today")
    )
    [kept] = orphans.rglob("x.h5")
    assert kept.relative_to(orphans).parts[0] == str(today)


def test_no_orphans_are_removed_after_the_clock_was_set(filled):
    old = filled.layout.orphans / "2020-01-01"
    old.mkdir(parents=True)
    filled.layout.clock.write_text('{"at_s": 0.0, "waits_s": 0.0}')
    filled.recover()
    assert old.exists()


def test_a_start_removes_what_killed_backups_left_in_the_data_directory(filled):
    data = filled.layout.data_dir
    for name in (".backup-a1b2c3d4", ".tensormap-backup-x"):
        (data / name).mkdir()
        (data / name / "catalog.sqlite3").touch()
    (data / ".backup.tar.0123.part").touch()
    (data / "backup.tar").touch()  # a backup, and none of a server's business
    filled.recover()
    assert {path.name for path in data.iterdir() if "backup" in path.name} == {"backup.tar"}


@pytest.mark.parametrize("held", [[], [".x.h5.0123.part"]])
def test_a_folder_without_files_is_removed_by_a_start_and_not_logged(filled, held, caplog):
    drive = filled.layout.drive(filled.maps.get("campus").id, "d" * 32)
    (drive / "chunks").mkdir(parents=True)
    for name in held:  # of an upload that was killed before its first file was whole
        (drive / "chunks" / name).touch()
    with caplog.at_level(logging.INFO, "tensormap.storage"):
        filled.recover()
    assert not drive.exists()
    assert not filled.layout.orphans.exists()
    assert caplog.text == ""


def test_what_is_half_written_in_a_folder_that_no_row_names_is_removed_and_the_rest_kept(filled):
    chunks = filled.layout.chunks(filled.maps.get("campus").id, "d" * 32)
    chunks.mkdir(parents=True)
    (chunks / ".x.h5.0123.part").touch()
    (chunks / "x.h5").write_bytes(b"who knows")
    filled.recover()
    [kept] = (path for path in filled.layout.orphans.rglob("*") if path.is_file())
    assert kept.read_bytes() == b"who knows"


def test_a_store_on_any_database_is_verified_and_repaired(database_url, tmp_path):
    with Store(tmp_path / "data", database_url) as store:
        store.maps.create("campus")
        for index in range(3):
            store.drives.put_scan("campus", "monday", index, sample_scan(index, 200))
        store.drives.close("campus", "monday")
        assert verify(store).findings == ()
        flip(packed(store), sample_scan(1, 200).points_m.tobytes())
        found = verify(store, repair=True)
        assert [finding.condition for finding in found.findings] == [Condition.DAMAGED]
        for index in (0, 2):
            assert len(store.drives.read_scan("campus", "monday", index)) == 200
