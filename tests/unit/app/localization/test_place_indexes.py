"""The index of all places of a shared basis."""

import shutil

import pytest

from app.localization import place_indexes
from app.localization.place_indexes import PlaceIndexes
from core.mapping.build import fit_map
from core.projection.images import MemoryImages
from storage.catalog import RevisionFacts
from storage.files import map_file
from storage.files.map_file import write_map
from storage.store import Store
from tests.support.samples import own_signatures, random_images, sample_harmonic_map

MAPS, SCANS = 12, 16


def map_of(basis, like, seed):
    images = random_images(3 * SCANS, like.parameters.grid.shape, seed).reshape(SCANS, 3, 6, 18)
    source = MemoryImages(images, like.parameters.grid)
    start = like.model.segment_start
    return fit_map(source, like.trajectory, start, like.parameters, kept=basis)


def add(store, slug, tensor_map, **options):
    known = {one.slug for one in store.catalog.live_maps.all()}
    of_map = store.maps.get(slug) if slug in known else store.maps.create(slug)
    facts = RevisionFacts("harmonic", SCANS, 2, {}, bases=tensor_map.basis_digests)
    store.revisions.add(
        of_map.id,
        tensor_map.revision,
        lambda path: write_map(path, tensor_map),
        facts,
        **options,
    )


@pytest.fixture(scope="module")
def maps():
    like, _ = sample_harmonic_map(SCANS)
    basis = like.basis()
    return basis, {f"d{n:02}": map_of(basis, like, n) for n in range(MAPS + 2)}


@pytest.fixture
def store(maps, tmp_path):
    basis, of_slug = maps
    with_maps = Store(tmp_path / "data")
    with_maps.bases.add("city", basis)
    for slug in list(of_slug)[:MAPS]:
        add(with_maps, slug, of_slug[slug])
    yield with_maps
    with_maps.close()


def live(store):
    return [one for one in store.catalog.live_maps.all() if one.revision is not None]


def updated(indexes, basis):
    indexes.update(basis.digest)
    index = indexes.open(basis.digest)
    assert index is not None
    return index


def found(store, index, tensor_map, row, maps=None):
    """Return the slugs of the maps that a scan's own signature may be of, best first."""
    slugs = {one.map_id: one.slug for one in live(store)}
    [signature] = own_signatures(tensor_map, row)
    return [slugs[map_id] for map_id in index.nearest_maps(maps or live(store), signature)]


def test_a_place_is_found_in_its_map(store, maps):
    basis, of_slug = maps
    indexes = PlaceIndexes(store)
    assert indexes.open(basis.digest) is None
    index = updated(indexes, basis)
    assert all(index.has(one) for one in live(store))
    for slug in list(of_slug)[:MAPS]:
        assert found(store, index, of_slug[slug], 5)[0] == slug


def test_only_the_maps_that_may_be_found_are(store, maps):
    basis, of_slug = maps
    indexes = PlaceIndexes(store)
    index = updated(indexes, basis)
    some = [one for one in live(store) if one.slug in {"d03", "d07"}]
    assert set(found(store, index, of_slug["d05"], 4, some)) == {"d03", "d07"}
    assert found(store, index, of_slug["d07"], 4, some)[0] == "d07"


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
    assert all(index.has(one) for one in live(store))
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


def test_what_is_damaged_or_gone_is_made_again(store, maps):
    basis, of_slug = maps
    PlaceIndexes(store).update(basis.digest)
    folder = store.layout.index / basis.digest
    for damage in (
        lambda: next(folder.glob("part-*/codes.npy")).write_bytes(b"nothing"),
        lambda: next(folder.glob("part-*/members.npy")).unlink(),
        lambda: shutil.rmtree(next(folder.glob("code-*"))),
        lambda: (folder / "index.json").write_bytes(b"{"),
        lambda: shutil.rmtree(folder),
    ):
        damage()
        indexes = PlaceIndexes(store)
        assert indexes.open(basis.digest) is None
        assert found(store, updated(indexes, basis), of_slug["d06"], 3)[0] == "d06"
        assert len(list(folder.glob("part-*"))) == 1


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


def test_of_few_maps_there_is_no_index(store, maps, monkeypatch):
    basis, _ = maps
    indexes = PlaceIndexes(store)
    indexes.update(basis.digest)
    monkeypatch.setattr(place_indexes, "FEWEST_MAPS", MAPS + 1)
    indexes.update(basis.digest)
    assert indexes.open(basis.digest) is None


def test_parts_are_joined_and_lists_find_what_all_codes_do(store, maps, monkeypatch):
    basis, of_slug = maps
    monkeypatch.setattr(place_indexes, "_AT_ONCE", 5)
    monkeypatch.setattr(place_indexes, "_MOST_JOINED", 6 * SCANS)
    indexes = PlaceIndexes(store)
    index = updated(indexes, basis)
    assert len(index.parts) > 1
    monkeypatch.setattr("core.encodings.harmonic.place_index._FEW_PLACES", 0)
    assert found(store, index, of_slug["d08"], 6)[0] == "d08"
    some = [one for one in live(store) if one.slug != "d08"]
    assert "d08" not in found(store, index, of_slug["d08"], 6, some)
