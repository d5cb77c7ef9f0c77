"""Import of a revision from a map file."""

from app.builds.parameters import as_built
from core.errors import InvalidMap
from storage.catalog import RevisionFacts, RevisionRecord
from storage.errors import CorruptFile, RevisionNotFound
from storage.files.map_file import map_of_bytes, write_map
from storage.store import Store


def import_revision(
    store: Store, map_slug: str, body: bytes, *, make_live: bool
) -> tuple[RevisionRecord, bool]:
    """Add a map file to a map as a revision.

    The stored file is written from the values that were read and checked, so that nothing else in
    the body is stored. The scans of its drives are not stored, so no build can be based on it.

    Args:
        store: The store.
        map_slug: The map.
        body: The bytes of an HDF5 file.
        make_live: Make it live even if it is not the map's first.

    Returns:
        The revision, and whether it is new to the map.

    Raises:
        MapNotFound: If there is no such map.
        InvalidMap: If the file is no map, is damaged, or its content has another digest.
        StorageFull: If no space is left; nothing is changed.
    """
    map_id = store.maps.get(map_slug).id
    try:
        tensor_map = map_of_bytes(body, "the body")
    except CorruptFile as error:
        raise InvalidMap(str(error)) from error
    parameters = tensor_map.parameters
    facts = RevisionFacts(
        encoding=parameters.encoding,
        scans=len(tensor_map),
        segments=tensor_map.model.segments,
        parameters={
            "imported": True,
            **as_built(parameters),
            "drives": list(tensor_map.trajectory.drives),
            "calibrated": tensor_map.calibration is not None,
        },
        bases=tensor_map.basis_digests,
    )
    try:
        store.revisions.get(map_slug, tensor_map.revision)
        added = False
    except RevisionNotFound:
        added = True
    record = store.revisions.add(
        map_id,
        tensor_map.revision,
        lambda path: write_map(path, tensor_map),
        facts,
        make_live=make_live,
    )
    return record, added
