"""Placements of a base that are of the poses which its drives have now."""

from collections.abc import Mapping, Sequence
from typing import Any

from app.builds.plans import Plan
from core.mapping.components import placements_without
from core.mapping.placement import Placement
from core.scans.pose import digest_of_poses, is_known
from storage.store import StoredDrive


def kept_placements(
    plan: Plan, drives: Sequence[StoredDrive]
) -> tuple[dict[str, Placement], tuple[str, ...]]:
    """Return the placements of a plan whose drives have the same poses, and notes on the others.

    A drive that was uploaded again, or got other poses, is where these say; scans that came since
    change nothing. Those of a base that an earlier version built are kept. A drive that lay beside
    the others, fitted to one that is elsewhere now, still does.
    """
    placements: dict[str, Placement] = {}
    elsewhere: list[str] = []
    for drive in drives:
        if drive.name not in plan.placements:
            continue
        placements[drive.name] = Placement.from_attributes(plan.placements[drive.name])
        placed = plan.placed_poses.get(drive.name)
        if placed is not None and _digest(drive, placed["last_scan"]) != placed["sha256"]:
            elsewhere.append(drive.name)
    notes = tuple(
        f"drive {name}: its poses are others than those that the base transformed: the transform"
        " is not applied"
        for name in elsewhere
    )
    posed = [drive.name for drive in drives if is_known(drive.poses).any()]
    return placements_without(posed, placements, elsewhere), notes


def placed_poses(
    placements: Mapping[str, Placement], drives: Sequence[StoredDrive]
) -> dict[str, dict[str, Any]]:
    """Return by drive which poses placements transform, in plain values."""
    found: dict[str, dict[str, Any]] = {}
    for drive in drives:
        scans = drive.scan_index[is_known(drive.poses)]
        if drive.name in placements and len(scans):
            last = int(scans.max())
            found[drive.name] = {"last_scan": last, "sha256": _digest(drive, last)}
    return found


def _digest(drive: StoredDrive, last_scan: int) -> str:
    """Return the digest of a drive's poses up to a scan."""
    until = (drive.scan_index <= last_scan) & is_known(drive.poses)
    return digest_of_poses(drive.poses[until])
