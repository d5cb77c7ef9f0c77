"""Checks of proposed loop closures."""

from collections.abc import Iterator
from contextlib import contextmanager

from app.access.api_router import api_router
from app.access.scopes import Scope, needs
from app.drives.mapped_drives import StoredScans
from app.http.bodies.bodies import Json
from app.http.client import require_client
from app.http.errors import JSON_BODY, READING
from app.http.pooled_route import heavy
from app.http.problems import problems
from app.http.slugs import MapSlug
from app.localization.signature_schemas import SignaturesIn
from app.loop_closures.schemas import (
    LoopClosureOut,
    LoopClosuresIn,
    LoopClosuresOut,
    ProposalIn,
    StoredScanIn,
)
from app.service import Running, Service
from core.errors import InvalidScan, InvalidSignature, StaleSignature, UnknownSegment
from core.loop_closure.closure import LoopClosure, check_scans, check_signatures
from storage import errors as stored

router = api_router(tags=["loop closures"])


_OF_PROPOSALS = (
    stored.DriveNotFound,
    stored.ScanNotFound,
    stored.ReturnsGone,
    StaleSignature,
    UnknownSegment,
    InvalidSignature,
    InvalidScan,
    stored.CorruptFile,
)


@router.post(
    "/maps/{map}/loop-closures",
    dependencies=[needs(Scope.LOCALIZE)],
    responses=problems(
        stored.MapNotFound, stored.NoLiveRevision, *_OF_PROPOSALS, *JSON_BODY, *READING
    ),
)
@heavy
def check_loop_closures(
    map_slug: MapSlug, body: Json[LoopClosuresIn], running: Running
) -> LoopClosuresOut:
    """Check proposed closures before they are used to correct a map.

    Two stored scans are compared by their returns in every heading: reliable, and independent of
    the map's encoding. They are those of builds: accumulated and in the vehicle's frame where their
    drive is. A scan of which only signatures came is compared by these, which is far less
    reliable.
    """
    height_m = body.sensor_height_m
    if height_m is None and any(isinstance(p.second, StoredScanIn) for p in body.proposals):
        height_m = running.revisions.live(map_slug).localizer.map.parameters.sensor_height_m
    stored_scans = StoredScans(running.store, map_slug, height_m or 0.0)
    closures = []
    for number, proposal in enumerate(body.proposals):
        require_client()
        with _of_proposal(number, proposal):
            found = _check(running, map_slug, proposal, height_m or 0.0, stored_scans)
        closures.append(LoopClosureOut.from_core(found, body.accept_from))
    return LoopClosuresOut(closures=closures)


@contextmanager
def _of_proposal(number: int, proposal: ProposalIn) -> Iterator[None]:
    """Name a proposal, counted from 0, and its scans in the errors that it causes."""
    try:
        yield
    except _OF_PROPOSALS as error:
        scans = " and ".join(map(_named, (proposal.first, proposal.second)))
        raise type(error)(f"proposal {number} of {scans}: {error}") from error


def _named(scan: StoredScanIn | SignaturesIn) -> str:
    if isinstance(scan, StoredScanIn):
        return f"scan {scan.scan_index} of drive {scan.drive!r}"
    return "signatures"


def _check(
    running: Service,
    map_slug: str,
    proposal: ProposalIn,
    sensor_height_m: float,
    stored_scans: StoredScans,
) -> LoopClosure:
    drive, index = proposal.first.drive, proposal.first.scan_index
    if isinstance(second := proposal.second, StoredScanIn):
        first_scan = stored_scans.scan(drive, index)
        second_scan = stored_scans.scan(second.drive, second.scan_index)
        return check_scans(first_scan, second_scan, sensor_height_m)
    signatures = second.to_core()
    localizer = running.revisions.of_signature(map_slug, second.named).localizer
    row = localizer.map.trajectory.row_of(drive, index)
    if row is None:
        raise stored.ScanNotFound(
            f"revision {localizer.map.revision[:12]} has no scan {index} of a drive {drive!r}"
        )
    return check_signatures(localizer, row, signatures)
