"""A damaged index: what is damaged is made again, and the rest stays."""

import os
import shutil

import numpy as np
import pytest

from app.access.caller import Caller
from app.localization import place_indexes
from app.localization.all_maps import AllMapsSearch
from app.localization.place_indexes import PlaceIndexes
from storage.files import map_file
from storage.files.place_files import PlaceFiles
from tests.support.indexed_maps import MAPS, SCANS, add, found, live, opened_maps, updated
from tests.support.process import until


def cut_off(file, size_bytes):
    assert file.stat().st_size > size_bytes
    os.truncate(file, size_bytes)


def name_more_places(folder):
    files = PlaceFiles(folder)
    manifest = files.manifest()
    assert manifest is not None
    manifest.parts[0].maps[-1].end += 1
    files.replace(manifest)


def flip_top_bit(file):
    """Change a bit of the last number of an array, in the file that may be mapped."""
    with file.open("r+b") as opened:
        opened.seek(-1, os.SEEK_END)
        last = opened.read(1)[0]
        opened.seek(-1, os.SEEK_END)
        opened.write(bytes([last ^ 0x40]))


def folders(store, basis):
    return {path.name for path in (store.layout.index / basis.digest).glob("part-*")}


def test_what_is_damaged_or_gone_is_made_again(store, maps):
    basis, of_slug = maps
    PlaceIndexes(store).update(basis.digest)
    folder = store.layout.index / basis.digest
    for spoil in (
        lambda: next(folder.glob("part-*/codes.npy")).write_bytes(b"nothing"),
        lambda: cut_off(next(folder.glob("part-*/codes.npy")), 0),
        lambda: cut_off(next(folder.glob("part-*/codes.npy")), 40),
        lambda: cut_off(next(folder.glob("part-*/codes.npy")), 400),
        lambda: name_more_places(folder),
        lambda: next(folder.glob("part-*/hidden.npy")).unlink(),
        lambda: shutil.rmtree(next(folder.glob("part-*"))),
        lambda: (folder / "index.json").write_bytes(b"{"),
        lambda: shutil.rmtree(folder),
    ):
        spoil()
        indexes = PlaceIndexes(store)
        assert indexes.open(basis.digest) is None
        assert found(store, updated(indexes, basis), of_slug["d06"], 3)[0] == "d06"
        assert len(list(folder.glob("part-*"))) == 1


def in_two_parts(store, basis, monkeypatch):
    """Make an index of two parts; return the folder of each and the revisions in it."""
    monkeypatch.setattr(place_indexes, "_AT_ONCE", MAPS // 2 * SCANS)
    monkeypatch.setattr(place_indexes, "_MOST_JOINED", MAPS // 2 * SCANS)
    parts = updated(PlaceIndexes(store), basis).parts
    assert len(parts) == 2
    return [(part.folder, {one.revision for one in part.maps}) for _, part in parts]


def noting_what_is_read(monkeypatch):
    """Return the set to which the revisions are added that are read from now on."""
    read: set[str] = set()

    def read_revision(path, digest):
        read.add(digest)
        return map_file.read_revision(path, digest)

    monkeypatch.setattr(place_indexes, "read_revision", read_revision)
    return read


@pytest.mark.parametrize(
    ("number", "spoil"),
    [
        (0, lambda part: flip_top_bit(part / "codes.npy")),
        (1, lambda part: flip_top_bit(part / "codes.npy")),
        (0, lambda part: flip_top_bit(part / "scales.npy")),
        (1, lambda part: flip_top_bit(part / "factors.npy")),
        (0, lambda part: flip_top_bit(part / "hidden.npy")),
        (1, lambda part: (part / "codes.npy").write_bytes(b"nothing")),
        (0, lambda part: cut_off(part / "codes.npy", 0)),
        (1, lambda part: cut_off(part / "codes.npy", 400)),
        (0, lambda part: (part / "hidden.npy").unlink()),
        (1, lambda part: shutil.rmtree(part)),
    ],
)
def test_a_damaged_part_is_made_again_and_the_other_stays(store, maps, monkeypatch, spoil, number):
    basis, of_slug = maps
    parts = in_two_parts(store, basis, monkeypatch)
    damaged, revisions = parts.pop(number)
    ((good, _),) = parts
    spoil(store.layout.index / basis.digest / damaged)
    read = noting_what_is_read(monkeypatch)
    index = updated(PlaceIndexes(store), basis)  # as after a start
    assert read == revisions
    assert good in folders(store, basis)
    assert damaged not in folders(store, basis)
    assert index.split(live(store)) == (live(store), [])
    for slug in ("d02", "d09"):
        assert found(store, index, of_slug[slug], 5)[0] == slug


def test_a_part_that_is_damaged_after_its_check_is_made_again_and_the_other_stays(
    store, maps, monkeypatch
):
    basis, _ = maps
    (good, _), (damaged, revisions) = in_two_parts(store, basis, monkeypatch)
    indexes = PlaceIndexes(store)
    indexes.update(basis.digest)  # checks both
    cut_off(store.layout.index / basis.digest / damaged / "codes.npy", 400)
    files = PlaceFiles(store.layout.index / basis.digest)
    manifest = files.manifest()
    assert manifest is not None
    files.replace(manifest)  # as another process that has changed it: it is opened again
    read = noting_what_is_read(monkeypatch)
    index = updated(indexes, basis)
    assert read == revisions
    assert good in folders(store, basis)
    assert index.split(live(store)) == (live(store), [])


def test_a_service_that_stops_during_a_check_keeps_the_index(store, maps, monkeypatch):
    basis, _ = maps
    _, (damaged, _) = in_two_parts(store, basis, monkeypatch)
    before = folders(store, basis)
    (store.layout.index / basis.digest / damaged / "hidden.npy").unlink()
    stopped = PlaceIndexes(store)
    stopped.stop()
    stopped.update(basis.digest)
    assert folders(store, basis) == before


def test_a_damaged_part_is_not_joined_with_a_new_one(store, maps):
    basis, of_slug = maps
    indexes = PlaceIndexes(store)
    updated(indexes, basis)
    large = folders(store, basis)
    add(store, "d12", of_slug["d12"])
    updated(indexes, basis)
    indexes.update(basis.digest)  # checks what was written
    (small,) = folders(store, basis) - large
    flip_top_bit(store.layout.index / basis.digest / small / "codes.npy")
    add(store, "d13", of_slug["d13"])
    _, missing = updated(indexes, basis).split(live(store))
    assert [one.slug for one in missing] == ["d12"]
    _, missing = updated(indexes, basis).split(live(store))
    assert missing == []


def test_a_search_that_a_damaged_index_breaks_is_answered_and_the_index_made_again(store, maps):
    basis, of_slug = maps
    indexes = PlaceIndexes(store)
    all_maps = AllMapsSearch(store, opened_maps(store), indexes, 64)
    updated(indexes, basis)
    indexes.update(basis.digest)  # checks what was written
    (folder,) = folders(store, basis)
    flip = np.load(store.layout.index / basis.digest / folder / "scales.npy", mmap_mode="r+")
    flip[...] *= -1.0
    asked = next(of_slug["d05"].model.own_queries([4], basis.digest))
    answer = all_maps.signature(Caller("key", frozenset()), asked, 1, None)
    assert answer.found.best.name == "d05"
    assert indexes._pending == {basis.digest}
    index = updated(indexes, basis)
    assert folders(store, basis).isdisjoint({folder})
    assert found(store, index, of_slug["d05"], 4)[0] == "d05"


def test_damage_that_is_reported_during_an_update_is_looked_for_by_the_next(
    store, maps, monkeypatch
):
    basis, _ = maps
    indexes = PlaceIndexes(store)
    updated(indexes, basis)
    matches_checksums, read = PlaceFiles.matches_checksums, []

    def checked(files, part):
        read.append(part.folder)
        if len(read) == 1:
            indexes.report_damage(basis.digest)
        return matches_checksums(files, part)

    monkeypatch.setattr(PlaceFiles, "matches_checksums", checked)
    for _ in range(3):
        indexes.update(basis.digest)
    (folder,) = folders(store, basis)
    assert read == [folder] * 2


def test_parts_are_checked_again_while_the_service_runs(store, maps, monkeypatch):
    basis, _ = maps
    indexes = PlaceIndexes(store)
    updated(indexes, basis)
    (folder,) = folders(store, basis)
    monkeypatch.setattr(place_indexes, "_CHECKED_FOR_S", 0.05)
    indexes.start()
    flip_top_bit(store.layout.index / basis.digest / folder / "codes.npy")
    until(lambda: not folders(store, basis) & {folder}, "the damaged part is still there")
    until(lambda: folders(store, basis), "no part was made again")
    indexes.stop()


def test_an_index_that_cannot_be_read_is_logged_once_and_read_when_it_was_made_again(
    store, maps, caplog
):
    basis, of_slug = maps
    PlaceIndexes(store).update(basis.digest)
    next((store.layout.index / basis.digest).glob("part-*/hidden.npy")).unlink()
    one, other = PlaceIndexes(store), PlaceIndexes(store)
    assert [one.open(basis.digest) for _ in range(3)] == [None] * 3  # of as many queries
    assert caplog.text.count("cannot be read: what is damaged is made again") == 1
    other.update(basis.digest)
    index = one.open(basis.digest)
    assert index is not None
    assert found(store, index, of_slug["d05"], 4)[0] == "d05"
