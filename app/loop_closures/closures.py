"""Checks of proposed closures between scans of a stored map."""

from app.http.client import require_client
from app.loop_closures.schemas import LoopClosuresIn, StoredScanIn
from app.revisions.loaded import LoadedRevisions
from core.loop_closure.closure import LoopClosure, check_scans, check_signatures
from storage.errors import ScanNotFound
from storage.store import Store


def check_closures(
    store: Store, revisions: LoadedRevisions, map_slug: str, body: LoopClosuresIn
) -> list[LoopClosure]:
    """Check each proposal, in their order.

    Raises:
        MapNotFound: If there is no such map.
        DriveNotFound: If the drive of a stored scan does not exist.
        ScanNotFound: If a stored scan does not exist, or is not in the revision of the signatures.
        ReturnsGone: If the returns of a stored scan were dropped after a build.
        NoLiveRevision: If the map has no revision yet, and one is needed.
        InvalidScan: If a stored scan has no returns above the ground.
        TensorMapError: As `Localizer.compare`.
    """
    height_m = body.sensor_height_m
    if height_m is None and any(isinstance(p.second, StoredScanIn) for p in body.proposals):
        height_m = revisions.live(map_slug).localizer.map.parameters.sensor_height_m
    found = []
    for proposal in body.proposals:
        require_client()
        drive, index = proposal.first.drive, proposal.first.scan_index
        if isinstance(second := proposal.second, StoredScanIn):
            first_scan = store.drives.read_scan(map_slug, drive, index)
            second_scan = store.drives.read_scan(map_slug, second.drive, second.scan_index)
            found.append(check_scans(first_scan, second_scan, height_m or 0.0))
            continue
        signatures = second.to_core()
        localizer = revisions.of_signature(map_slug, second.named).localizer
        row = localizer.map.trajectory.row_of(drive, index)
        if row is None:
            raise ScanNotFound(
                f"revision {localizer.map.revision[:12]} has no scan {index} of a drive {drive!r}"
            )
        found.append(check_signatures(localizer, row, signatures))
    return found
