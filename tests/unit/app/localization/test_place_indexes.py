"""The index of all places of a shared basis."""

import gc
import json
import shutil
import threading
import weakref
from dataclasses import replace

import numpy as np
import pytest

from app.access.caller import Caller
from app.localization import place_indexes
from app.localization.all_maps import AllMapsSearch
from app.localization.place_indexes import PlaceIndexes
from core.encodings.harmonic.model import HarmonicModel
from core.localization.all_maps import localize_in_maps
from core.projection.imager import Image
from storage.errors import StorageFull
from storage.files import map_file
from tests.support.indexed_maps import (
    MAPS,
    SCANS,
    add,
    found,
    images_of,
    live,
    opened_maps,
    updated,
)
from tests.support.process import until
from tests.support.samples import own_signatures
from tests.support.service import damage


def test_a_place_is_found_in_its_map(store, maps):
    basis, of_slug = maps
    indexes = PlaceIndexes(store)
    assert indexes.open(basis.digest) is None
    index = updated(indexes, basis)
    assert index.split(live(store)) == (live(store), [])
    for slug in list(of_slug)[:MAPS]:
        assert found(store, index, of_slug[slug], 5)[0] == slug


def test_a_scan_is_found_in_its_map(store, maps):
    basis, of_slug = maps
    index = updated(PlaceIndexes(store), basis)
    for number, slug in enumerate(list(of_slug)[:MAPS]):
        tensor_map = of_slug[slug]
        cells = images_of(tensor_map, number)[7, 1]
        nearest = index.nearest_maps(live(store), Image(cells, tensor_map.parameters.grid))
        assert nearest[0].slug == slug


def test_only_the_maps_that_may_be_found_are(store, maps):
    basis, of_slug = maps
    indexes = PlaceIndexes(store)
    index = updated(indexes, basis)
    some = [one for one in live(store) if one.slug in {"d03", "d07"}]
    assert set(found(store, index, of_slug["d05"], 4, some)) == {"d03", "d07"}
    assert found(store, index, of_slug["d07"], 4, some)[0] == "d07"


@pytest.mark.parametrize("may_see", [MAPS, 10])
def test_an_answer_counts_all_places_that_were_searched(store, maps, monkeypatch, may_see):
    basis, of_slug = maps
    indexes = PlaceIndexes(store)
    updated(indexes, basis)
    counted = []

    def localized(searched, *args, other_places, **options):
        opened = list(searched)
        counted.append((other_places, sum(len(one.tensor_map) for one in opened)))
        return localize_in_maps(opened, *args, other_places=other_places, **options)

    monkeypatch.setattr("app.localization.all_maps.localize_in_maps", localized)
    search = AllMapsSearch(store, opened_maps(store), indexes, 8)
    caller = Caller("some", frozenset(), frozenset(list(of_slug)[:may_see]))
    asked = next(of_slug["d02"].model.own_queries([5], basis.digest))
    search.signature(caller, asked, 1, None)
    assert counted == [((may_see - 3) * SCANS, 3 * SCANS)]


def test_a_map_is_added_and_another_removed_without_the_others_being_read(store, maps, monkeypatch):
    basis, of_slug = maps
    indexes = PlaceIndexes(store)
    indexes.update(basis.digest)
    read: list[str] = []

    def read_revision(path, digest):
        read.append(digest)
        return map_file.read_revision(path, digest)

    monkeypatch.setattr(place_indexes, "read_revision", read_revision)
    add(store, "d12", of_slug["d12"])
    add(store, "d02", of_slug["d13"], make_live=True)
    store.maps.delete("d04")
    indexes.update(basis.digest)
    assert set(read) == {of_slug["d12"].revision, of_slug["d13"].revision}
    index = indexes.open(basis.digest)
    assert index is not None
    assert index.split(live(store)) == (live(store), [])
    assert found(store, index, of_slug["d12"], 3)[0] == "d12"
    assert found(store, index, of_slug["d13"], 3)[0] == "d02"
    assert "d04" not in found(store, index, of_slug["d04"], 3)
    assert len(index.places_of) == MAPS


def test_places_of_a_map_that_is_gone_are_not_found_before_they_are_removed(store, maps):
    basis, of_slug = maps
    indexes = PlaceIndexes(store)
    index = updated(indexes, basis)
    store.maps.delete("d04")
    assert "d04" not in found(store, index, of_slug["d04"], 3)


def test_places_of_a_map_that_is_gone_are_none_of_the_map_before_them(store, maps):
    basis, of_slug = maps
    indexes = PlaceIndexes(store)
    updated(indexes, basis)
    store.maps.delete("d04")
    index = updated(indexes, basis)
    asked, other = (own_signatures(of_slug[slug], 5)[0] for slug in ("d04", "d07"))
    asked = replace(asked, values=0.6 * asked.values + 0.4 * other.values)
    assert index.nearest_maps(live(store), [asked])[0].slug == "d07"


def test_a_map_of_which_another_revision_is_live_is_not_indexed(store, maps):
    basis, of_slug = maps
    index = updated(PlaceIndexes(store), basis)
    add(store, "d02", of_slug["d13"], make_live=True)
    indexed, missing = index.split(live(store))
    assert [one.slug for one in missing] == ["d02"]
    assert len(indexed) == MAPS - 1


def test_another_process_sees_what_one_has_updated(store, maps):
    basis, of_slug = maps
    one, other = PlaceIndexes(store), PlaceIndexes(store)
    one.update(basis.digest)
    before = other.open(basis.digest)
    add(store, "d12", of_slug["d12"])
    one.update(basis.digest)
    after = other.open(basis.digest)
    assert before is not None
    assert after is not None
    assert len(after.places_of) == len(before.places_of) + 1
    assert other.open(basis.digest) is after


def test_the_files_of_an_index_that_was_replaced_are_released_at_once(store, maps):
    basis, of_slug = maps
    indexes = PlaceIndexes(store)
    all_maps = AllMapsSearch(store, opened_maps(store), indexes, 64)
    caller = Caller("key", frozenset())
    asked = next(of_slug["d05"].model.own_queries([4], basis.digest))
    gc.disable()  # nothing waits for it: it may not run for long
    try:
        replaced = weakref.ref(updated(indexes, basis))
        assert all_maps.signature(caller, asked, 1, None).found.best.name == "d05"
        add(store, "d12", of_slug["d12"])
        indexes.update(basis.digest)
        assert all_maps.signature(caller, asked, 1, None).found.best.name == "d05"
        assert replaced() is None
    finally:
        gc.enable()


def test_the_files_of_an_index_that_is_removed_are_released(store, maps, monkeypatch):
    basis, _ = maps
    indexes = PlaceIndexes(store)
    removed = weakref.ref(updated(indexes, basis))
    monkeypatch.setattr(place_indexes, "FEWEST_MAPS", MAPS + 1)
    indexes.update(basis.digest)
    assert removed() is None


def test_the_files_of_an_index_whose_basis_is_deleted_are_released(store, maps, monkeypatch):
    basis, of_slug = maps
    monkeypatch.setattr(place_indexes, "_CHECKED_FOR_S", 0.05)
    indexes = PlaceIndexes(store)
    removed = weakref.ref(updated(indexes, basis))
    for slug in list(of_slug)[:MAPS]:
        store.maps.purge(slug)
    store.bases.delete("city")
    indexes.start()
    try:
        until(lambda: removed() is None, "the index is still open")
    finally:
        indexes.stop()


def test_of_few_maps_there_is_no_index(store, maps, monkeypatch):
    basis, _ = maps
    indexes = PlaceIndexes(store)
    indexes.update(basis.digest)
    monkeypatch.setattr(place_indexes, "FEWEST_MAPS", MAPS + 1)
    indexes.update(basis.digest)
    assert indexes.open(basis.digest) is None


def test_parts_are_joined_and_only_the_ranges_of_maps_are_read(store, maps, monkeypatch):
    basis, of_slug = maps
    monkeypatch.setattr(place_indexes, "_AT_ONCE", 5 * SCANS)
    monkeypatch.setattr(place_indexes, "_MOST_JOINED", 6 * SCANS)
    indexes = PlaceIndexes(store)
    index = updated(indexes, basis)
    assert len(index.parts) > 1
    assert found(store, index, of_slug["d08"], 6)[0] == "d08"
    some = [one for one in live(store) if one.slug != "d08"]
    assert "d08" not in found(store, index, of_slug["d08"], 6, some)


def test_no_map_is_kept_in_memory_while_an_index_is_made(store, maps, monkeypatch):
    basis, _ = maps
    alive: weakref.WeakSet[object] = weakref.WeakSet()
    most = []

    def read_revision(path, digest):
        most.append(len(alive))
        read = map_file.read_revision(path, digest)
        alive.add(read.model)
        return read

    monkeypatch.setattr(place_indexes, "read_revision", read_revision)
    monkeypatch.delattr(HarmonicModel, "signatures")  # a small map keeps them decoded
    PlaceIndexes(store).update(basis.digest)
    assert len(most) == MAPS
    assert max(most) <= 1


def test_an_index_of_an_older_version_is_made_again(store, maps):
    basis, of_slug = maps
    folder = store.layout.index / basis.digest
    (folder / "code-1").mkdir(parents=True)
    (folder / "part-2").mkdir()
    for name in ("code-1/projection.npy", "part-2/codes.npy", "part-2/members.npy"):
        np.save(folder / name, np.zeros((MAPS * SCANS, 5, 64), np.int8))
    spans = [(one.map_id, one.revision, n) for n, one in enumerate(live(store))]
    listed = [
        {"map_id": of, "revision": revision, "start": n * SCANS, "end": (n + 1) * SCANS}
        for of, revision, n in spans
    ]
    parts = [{"folder": "part-2", "maps": listed}]
    older = {"version": 1, "code": "code-1", "trained": MAPS * SCANS, "parts": parts}
    (folder / "index.json").write_text(json.dumps(older))
    indexes = PlaceIndexes(store)
    assert indexes.open(basis.digest) is None
    index = updated(indexes, basis)
    assert found(store, index, of_slug["d08"], 6)[0] == "d08"
    assert len(index.places_of) == MAPS
    assert {path.name for path in folder.iterdir() if path.is_dir()} == {
        part.folder for _, part in index.parts
    }


def test_a_map_that_cannot_be_indexed_is_left_out_and_wakes_nobody(store, maps):
    basis, of_slug = maps
    record = store.revisions.live("d03")
    damage(store.revisions.path_of(record), b"nothing")
    indexes = PlaceIndexes(store)
    index = updated(indexes, basis)
    assert len(index.places_of) == MAPS - 1
    _, damaged = index.split(live(store))
    indexes.wake(basis.digest, damaged)
    assert indexes._pending == set()
    add(store, "d12", of_slug["d12"])
    indexes.wake(basis.digest, index.split(live(store))[1])
    assert indexes._pending == {basis.digest}


def test_any_error_of_an_update_is_logged_and_the_next_one_is_made(
    store, maps, monkeypatch, caplog
):
    basis, _ = maps
    indexes = PlaceIndexes(store)
    update, done = indexes.update, threading.Event()

    def failing(digest):
        monkeypatch.setattr(indexes, "update", noted)
        raise MemoryError

    def noted(digest):
        update(digest)
        done.set()

    monkeypatch.setattr(indexes, "update", failing)
    indexes.start()
    until(lambda: "cannot be brought up to date" in caplog.text, "the error")
    indexes.wake(basis.digest)
    assert done.wait(60)
    indexes.stop()
    assert indexes.open(basis.digest) is not None


def test_an_update_that_failed_is_not_repeated_by_each_query(store, maps, monkeypatch, caplog):
    basis, _ = maps
    indexes = PlaceIndexes(store)

    def fail(_digest):
        raise StorageFull("no space is left")

    monkeypatch.setattr(indexes, "update", fail)
    indexes.start()
    until(lambda: "cannot be brought up to date" in caplog.text, "the error")
    indexes.stop()
    indexes.wake(basis.digest, live(store))
    assert indexes._pending == set()
    monkeypatch.setattr(place_indexes, "_RETRY_S", 0.0)
    indexes.wake(basis.digest, live(store))
    assert indexes._pending == {basis.digest}


def test_an_index_ends_with_its_basis(store, maps):
    basis, of_slug = maps
    indexes = PlaceIndexes(store)
    updated(indexes, basis)
    folder = store.layout.index / basis.digest
    other = shutil.copytree(folder, folder.with_name("0" * 64))
    indexes.start()
    indexes.stop()
    assert folder.exists()
    assert not other.exists()
    for slug in list(of_slug)[:MAPS]:
        store.maps.purge(slug)
    store.bases.delete("city")
    assert not folder.exists()
    assert indexes.open(basis.digest) is None
    assert indexes._open == {}
