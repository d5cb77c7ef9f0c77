"""How a proposed closure of a stored map is judged: by what is known of its two scans."""

from app.http.client import require_client
from app.loop_closures.schemas import LoopClosuresIn, StoredScanIn
from app.revisions.loaded import LoadedRevisions
from core.localization.localizer import Localizer
from core.loop_closure.closure import Likelihood, LoopClosure, check_scans, check_signatures
from core.mapping.tensormap import TensorMap
from core.scans.scan import Scan
from storage.errors import ScanNotFound
from storage.store import Store


def judge_closures(
    store: Store, revisions: LoadedRevisions, map_slug: str, wanted: LoopClosuresIn
) -> list[LoopClosure]:
    """Judge each proposal, in their order.

    Raises:
        MapNotFound: If there is no such map.
        DriveNotFound: If a drive of a stored scan is not there.
        ScanNotFound: If a stored scan is not there, or is not in the revision that is asked.
        ReturnsGone: If the returns of a stored scan were dropped after a build.
        NoLiveRevision: If nothing was built yet, and that is needed.
        InvalidScan: If a stored scan shows nothing that stands above the ground.
        TensorMapError: What `Localizer.compare` raises of signatures.
    """
    height_m = wanted.sensor_height_m
    if height_m is None and any(isinstance(p.second, StoredScanIn) for p in wanted.proposals):
        height_m = revisions.live(map_slug).localizer.map.parameters.sensor_height_m
    found = []
    for proposal in wanted.proposals:
        require_client()
        if isinstance(proposal.second, StoredScanIn):
            first, second = (
                _read(store, map_slug, scan) for scan in (proposal.first, proposal.second)
            )
            found.append(check_scans(first, second, height_m or 0.0))
            continue
        signatures = proposal.second.to_core()
        localizer = revisions.of_signature(map_slug, proposal.second.named).localizer
        row = _row_of(localizer, proposal.first)
        found.append(check_signatures(localizer, row, signatures, _likelihood(localizer.map)))
    return found


def _read(store: Store, map_slug: str, scan: StoredScanIn) -> Scan:
    return store.drives.read_scan(map_slug, scan.drive, scan.scan_index)


def _row_of(localizer: Localizer, scan: StoredScanIn) -> int:
    row = localizer.map.trajectory.row_of(scan.drive, scan.scan_index)
    if row is None:
        raise ScanNotFound(
            f"revision {localizer.map.revision[:12]} has no scan {scan.scan_index} of a drive"
            f" {scan.drive!r}"
        )
    return row


def _likelihood(tensor_map: TensorMap) -> Likelihood | None:
    """Return the map's calibration; a map that has none tells no probability."""
    likelihood: Likelihood | None = getattr(tensor_map, "calibration", None)
    return likelihood
