"""What builds write leaves the space that a deletion needs before it frees any."""

import shutil

import pytest

from core.localization.localizer import Localizer
from core.projection.imager import Imager
from core.projection.reducer import Reducer
from storage.catalog import RevisionFacts
from storage.errors import StorageFull
from storage.files.image_file import write_image_file
from storage.store.compaction import move_into_one
from tests.support.samples import SMALL_GRID, sample_drive, sample_harmonic_map
from tests.support.small_scans import sample_scan

FACTS = RevisionFacts(encoding="paper", scans=10, segments=2, parameters={})


def add_a_revision(store):
    map_id = store.maps.get("campus").id
    store.revisions.add(map_id, "a" * 64, lambda path: path.write_bytes(b"a map"), FACTS)


def add_a_basis(store):
    tensor_map, _ = sample_harmonic_map()
    store.bases.add("city", Localizer(tensor_map).basis)


def write_images(store):
    folder = store.drives.images_folder(store.drives.find("campus", "monday"))
    write_image_file(folder / "images.h5", sample_drive(5), Imager(SMALL_GRID, Reducer.LAST))


def pack(store):
    store.drives.close("campus", "monday")


def leave_less_than_is_kept(store, monkeypatch):
    usage = shutil.disk_usage(store.layout.data_dir)._replace(total=2**30, free=2**20)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)


@pytest.mark.parametrize("write", [add_a_revision, add_a_basis, write_images, pack])
def test_a_file_is_rejected_and_removed_that_takes_the_space_kept_for_the_catalog(
    store, monkeypatch, write
):
    for index in range(2):
        store.drives.put_scan("campus", "monday", index, sample_scan(index))
    before = set(store.layout.data_dir.rglob("*.h5"))
    leave_less_than_is_kept(store, monkeypatch)
    with pytest.raises(StorageFull, match="kept free for the catalog: delete something"):
        write(store)
    assert set(store.layout.data_dir.rglob("*.h5")) == before
    store.drives.delete("campus", "monday")


def test_scans_that_stay_where_others_lose_their_returns_are_moved_on_a_full_disk(
    store, monkeypatch
):
    for index in range(2):
        store.drives.put_scan("campus", "monday", index, sample_scan(index))
    leave_less_than_is_kept(store, monkeypatch)
    drive = store.drives.open("campus", "monday")
    [first, _] = store.catalog.scans.of_drive(drive.record.id)
    chunks = store.layout.chunks(drive.record.map_id, drive.record.id)
    move_into_one(store.catalog, drive.record.id, chunks, [first], drive.scan)
    moved = store.catalog.scans.get(drive.record.id, 0)
    assert moved.chunk != first.chunk
