"""Import of a revision from a map file."""

from dataclasses import dataclass

from app.access.trail import note
from app.builds.anchor_notes import anchor_notes
from app.builds.live_gate import Gate, compare_with_live
from app.builds.parameters import BuildParameters, as_built
from app.builds.recall import DrivenMap
from core.errors import InvalidMap
from storage.catalog import RevisionFacts, RevisionRecord
from storage.errors import CorruptFile, RevisionNotFound
from storage.files.map_file import map_of_bytes, write_map
from storage.store import Store


@dataclass(frozen=True)
class Imported:
    """An imported revision.

    Attributes:
        record: The revision.
        added: Whether it is new to the map.
        gate: Whether a build of this content would have become live.
        notes: Whether its frame may be another than that of the map's anchor.
    """

    record: RevisionRecord
    added: bool
    gate: Gate
    notes: tuple[str, ...]


def import_revision(store: Store, map_slug: str, body: bytes, *, make_live: bool) -> Imported:
    """Add a map file to a map as a revision, and compare its recall with the live one's.

    The stored file is written from the values that were read and checked, so that nothing else in
    the body is stored. The scans of its drives are not stored, so no build can be based on it.

    Args:
        store: The store.
        map_slug: The map.
        body: The bytes of an HDF5 file.
        make_live: Make it live even if it is not the map's first.

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
    note(f"revision {tensor_map.revision}")
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
            "placements": tensor_map.attributes().get("placements", {}),
        },
        bases=tensor_map.basis_digests,
    )
    gate = compare_with_live(
        store,
        map_id,
        DrivenMap({}, tensor_map),
        BuildParameters.model_fields["max_recall_loss"].default,
    )
    notes = tuple(anchor_notes(store, map_id, tensor_map, is_live=make_live))
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
    return Imported(record, added, gate, notes)
