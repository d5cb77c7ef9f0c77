"""A basis to be shared: of one map, or fitted to the drives of several."""

from collections.abc import Sequence

from app.drives.mapped_drives import mapped_drive
from app.drives.stored_images import images_path
from core.arrays import FloatArray
from core.encodings.basis import Basis, make_same_signatures
from core.errors import InvalidParameters
from core.scans.stands import first_of_stands
from storage.catalog import RevisionRecord
from storage.files.image_file import ImageFile
from storage.store import Store


def basis_of_maps(store: Store, map_slugs: Sequence[str]) -> Basis:
    """Return the basis of a map's live revision, or one fitted to those of several maps.

    It is fitted to the sums that are stored with the images of their drives; no scan is read.
    Where a file has no sum of the scans that count, all of its images are read.

    Args:
        store: The store.
        map_slugs: The maps' slugs, at least one.

    Raises:
        MapNotFound: If there is no such map.
        NoLiveRevision: If one has no revision yet.
        RevisionNotFound: If the live revision of one was replaced and removed meanwhile.
        InvalidParameters: If one makes signatures otherwise than the first, or is not built of
            drives that are still stored.
        CorruptFile: If a file is damaged.
    """
    records = [store.revisions.live(slug) for slug in map_slugs]
    if len(records) == 1:
        return store.revisions.read(records[0]).basis()
    grams: dict[str, FloatArray] = {}
    first, *_ = parameters = [store.revisions.read_parameters(record)[0] for record in records]
    if not first.encoder.shares_basis:
        raise InvalidParameters(
            f"map {map_slugs[0]!r} is in encoding {first.encoding}, in which each segment has a"
            " basis of its own: a common one can be fitted to harmonic maps only"
        )
    for slug, record, of_map in zip(map_slugs, records, parameters, strict=True):
        if not make_same_signatures(first, of_map):
            raise InvalidParameters(
                f"map {slug!r} makes signatures otherwise than map {map_slugs[0]!r}: a basis can be"
                " fitted to maps of one encoding, image and grid"
            )
        drives = store.drives.open_of_map(record.map_id, _drives(store, slug, record))
        for drive in drives:
            path = images_path(store, drive, of_map)
            if not path.exists():
                raise InvalidParameters(
                    f"the images of drive {drive.name!r} of map {slug!r} are no longer kept: build"
                    " the map again"
                )
            with ImageFile(path, of_map.imager) as images:
                poses = mapped_drive(drive, of_map.sensor_height_m).poses[images.scans]
                counted = first_of_stands(poses)
                grams[f"{slug}/{drive.name}"] = images.detail_gram(counted)
    return first.encoder.basis_of_grams(grams, first)


def _drives(store: Store, slug: str, record: RevisionRecord) -> list[str]:
    """Return the names that the drives of a revision have now."""
    stored = {drive.id: drive.slug for drive in store.drives.of_map(record.map_id)}
    gone = sorted(name for name, id_ in record.drive_ids.items() if id_ not in stored)
    if gone or not record.drive_ids:
        why = f"drive {gone[0]!r}, which is no longer stored" if gone else "no drive, but imported"
        raise InvalidParameters(
            f"the live revision of map {slug!r} is built of {why}: a basis cannot be fitted to it;"
            " build the map of stored drives and make that live"
        )
    return sorted(stored[id_] for id_ in record.drive_ids.values())
