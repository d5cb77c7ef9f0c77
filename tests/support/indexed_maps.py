"""Many small maps of one shared basis, and the index of their places."""

from app.localization.opened_maps import OpenedMaps
from app.revisions.loaded import LoadedRevisions
from core.mapping.fit import fit_map
from core.projection.images import MemoryImages
from storage.catalog import RevisionFacts
from storage.files.map_file import write_map
from tests.support.samples import own_signatures, random_images

MAPS, SCANS = 12, 16


def images_of(like, seed):
    return random_images(3 * SCANS, like.parameters.grid.shape, seed).reshape(SCANS, 3, 6, 18)


def map_of(basis, like, seed):
    source = MemoryImages(images_of(like, seed), like.parameters.grid)
    start = like.model.segment_start
    return fit_map(source, like.trajectory, start, like.parameters, kept=basis)


def add(store, slug, tensor_map, **options):
    known = {one.slug for one in store.catalog.map_summaries.all()}
    of_map = store.maps.get(slug) if slug in known else store.maps.create(slug)
    facts = RevisionFacts("harmonic", SCANS, 2, {}, bases=tensor_map.basis_digests)
    store.revisions.add(
        of_map.id,
        tensor_map.revision,
        lambda path: write_map(path, tensor_map),
        facts,
        **options,
    )


def opened_maps(store, *, loaded=4, scans=MAPS * SCANS):
    return OpenedMaps(LoadedRevisions(store, loaded), scans)


def live(store):
    return [one for one in store.catalog.map_summaries.all() if one.revision is not None]


def updated(indexes, basis):
    indexes.update(basis.digest)
    index = indexes.open(basis.digest)
    assert index is not None
    return index


def found(store, index, tensor_map, row, maps=None):
    """Return the slugs of the maps that a scan's own signature may be of, best first."""
    nearest = index.nearest_maps(maps or live(store), own_signatures(tensor_map, row))
    return [one.slug for one in nearest]
