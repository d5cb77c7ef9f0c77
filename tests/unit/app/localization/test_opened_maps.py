"""Which maps stay open for queries that name none."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from app.access.caller import Caller
from app.localization.all_maps import AllMapsSearch
from app.localization.opened_maps import OpenedMaps
from app.localization.place_indexes import PlaceIndexes
from app.revisions.loaded import LoadedRevisions
from storage.errors import MapNotFound
from storage.files.map_file import read_revision
from tests.support.indexed_maps import MAPS, SCANS, add, live, opened_maps


@pytest.fixture
def read(monkeypatch):
    """The digests of the revisions whose files are read."""
    digests: list[str] = []

    def counted(path, digest):
        digests.append(digest)
        return read_revision(path, digest)

    monkeypatch.setattr("storage.store.revisions.read_revision", counted)
    return digests


def summaries(store, *slugs):
    by_slug = {one.slug: one for one in live(store)}
    return [by_slug[slug] for slug in slugs]


def open_all(opened, maps, *, keep=True):
    return [opened.live(one, keep=keep) for one in maps]


def test_a_map_is_read_once_for_all_queries_among_maps(store, read):
    opened = opened_maps(store)
    first = open_all(opened, live(store))
    assert len(read) == MAPS
    assert open_all(opened, live(store)) == first
    assert len(read) == MAPS


def test_threads_that_need_the_same_map_read_it_once(store, read, monkeypatch):
    opened = opened_maps(store, scans=SCANS)
    [one] = summaries(store, "d03")
    began = threading.Barrier(4)

    def query(_):
        began.wait()
        return opened.live(one, keep=True)

    with ThreadPoolExecutor(4) as pool:
        assert len(set(pool.map(query, range(4)))) == 1
    assert len(read) == 1


def test_a_map_that_a_vehicle_named_is_not_kept_twice(store, read):
    revisions = LoadedRevisions(store, 2)
    opened = OpenedMaps(revisions, MAPS * SCANS)
    before, after = summaries(store, "d01", "d02")
    named = revisions.live("d01").localizer
    assert opened.live(before, keep=True) is named
    assert len(read) == 1
    replaced = opened.live(after, keep=True)
    named = revisions.live("d02").localizer
    assert named is not replaced
    assert opened.live(after, keep=True) is named
    for slug in ("d03", "d04"):
        revisions.live(slug)
    read.clear()
    assert opened.live(after, keep=True) is named  # no query of one map needs it any more
    assert read == []


def test_a_map_that_is_used_again_takes_its_room_once(store, read):
    revisions = LoadedRevisions(store, 1)
    opened = OpenedMaps(revisions, 2 * SCANS)
    one, two = summaries(store, "d01", "d02")
    revisions.live("d01")
    for _ in range(5):
        opened.live(one, keep=True)
    opened.live(two, keep=True)
    revisions.live("d03")
    read.clear()
    open_all(opened, [one, two])
    assert read == []


def test_maps_that_vehicles_named_are_not_replaced(store):
    revisions = LoadedRevisions(store, 2)
    opened = OpenedMaps(revisions, MAPS * SCANS)
    named = [revisions.live(slug).localizer for slug in ("d01", "d02")]
    open_all(opened, live(store))
    assert [revisions.live(slug).localizer for slug in ("d01", "d02")] == named


def test_the_maps_used_longest_ago_make_room(store, read):
    opened = opened_maps(store, scans=2 * SCANS)
    one, two, three = summaries(store, "d01", "d02", "d03")
    open_all(opened, [one, two, one, three])
    read.clear()
    open_all(opened, [one, three])
    assert read == []
    opened.live(two, keep=True)
    assert read == [two.revision]


def test_a_map_that_is_not_to_be_kept_leaves_those_that_are(store, read):
    opened = opened_maps(store, scans=2 * SCANS)
    one, two, three = summaries(store, "d01", "d02", "d03")
    open_all(opened, [one, two])
    open_all(opened, [three], keep=False)
    read.clear()
    open_all(opened, [one, two])
    assert read == []


def test_a_map_of_more_scans_than_are_kept_is_not(store, read):
    opened = opened_maps(store, scans=SCANS - 1)
    [one] = summaries(store, "d01")
    open_all(opened, [one, one])
    assert len(read) == 2


def test_of_more_maps_than_there_is_room_for_those_that_fit_stay(store, maps, read):
    basis, of_slug = maps
    fitting = 5
    opened = opened_maps(store, scans=fitting * SCANS)
    search = AllMapsSearch(store, opened, PlaceIndexes(store), 64)
    signature = next(of_slug["d02"].model.own_queries([5], basis.digest))

    def query():
        read.clear()
        found = search.signature(Caller("key", frozenset()), signature, 1, None)
        return found.found.best.name, len(read)

    assert [query() for _ in range(3)] == [("d02", MAPS), *[("d02", MAPS - fitting)] * 2]


def test_a_map_is_the_live_one(store, maps):
    _, of_slug = maps
    opened = opened_maps(store)
    [before] = summaries(store, "d02")
    opened.live(before, keep=True)
    add(store, "d02", of_slug["d13"], make_live=True)
    [after] = summaries(store, "d02")
    assert opened.live(after, keep=True).map.revision == of_slug["d13"].revision
    store.maps.delete("d02")
    with pytest.raises(MapNotFound):
        opened.live(after, keep=True)
