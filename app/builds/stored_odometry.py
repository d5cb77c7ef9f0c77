"""Odometry of stored drives without poses, as a part of their builds."""

import hashlib
import logging
from collections.abc import Sequence

import numpy as np

from app.builds.odometry import (
    LEAST_SCANS,
    MISSING,
    WANTED,
    doubt_notes,
    failure_note,
    origin_note,
    unposed,
)
from core.odometry.odometry import compute_odometry
from core.odometry.registration import library_version
from core.progress import NO_PROGRESS, Progress
from core.scans.mounting import stated_height_m
from core.scans.pose import is_known
from storage.catalog import ScanPoses
from storage.store import Store, StoredDrive

_log = logging.getLogger("tensormap.jobs")


def report_missing() -> None:
    """Log once, at the start of a service, that no poses can be computed, if so."""
    if library_version() is None:
        _log.info("builds cannot compute the poses of drives without any: %s", WANTED)


def pose_stored(
    store: Store,
    map_id: str,
    drives: Sequence[StoredDrive],
    sensor_height_m: float,
    progress: Progress = NO_PROGRESS,
) -> tuple[Sequence[StoredDrive], tuple[str, ...]]:
    """Return stored drives, those that came without poses with computed ones, and notes on these.

    Poses are computed once and stored with the drive; again only if it got more scans. Poses that
    are put while some are computed take their place.

    Args:
        store: The drives' store.
        map_id: The id of the drives' map.
        drives: The drives.
        sensor_height_m: The map's sensor height; used where a drive has no mounting.
        progress: Receives the stages of each drive.

    Raises:
        MapNotFound: If the map was deleted.
        DriveNotFound: If a drive was deleted.
        CorruptFile: If a stored scan is not the one that was put.
    """
    notes: list[str] = []
    changed = False
    for drive in drives:
        if not _lacks_poses(drive):
            continue
        if not drive.has_returns.all():
            gone = int((~drive.has_returns).sum())
            notes.append(
                f"{unposed(drive)}: odometry wants the returns of all scans, those of {gone} of"
                f" {len(drive)} were dropped after a build"
            )
            continue
        if library_version() is None:
            notes.append(f"{unposed(drive)}: {MISSING}")
            continue
        height_m = stated_height_m(drive.mounting, sensor_height_m)
        found = compute_odometry(drive, height_m, progress)
        if not found.usable:
            notes.append(failure_note(drive, found))
            continue
        facts = {**found.facts, "scans": _scans_digest(drive)}
        poses = ScanPoses(drive.scan_index, found.poses, np.full(len(drive), np.nan), found.sigmas)
        changed = True
        if not store.drives.set_computed_poses(drive.id, poses, facts):
            notes.append(
                f"drive {drive.name}: it was changed while odometry computed its poses: they are"
                " not used"
            )
    if changed:
        drives = store.drives.open_of_map(map_id, [drive.name for drive in drives])
        came = (d for d in drives if d.odometry is not None and _lacks_poses(d))
        notes += [f"{unposed(drive)}: build again when it is whole" for drive in came]
    posed = [(drive.name, drive.odometry) for drive in drives if drive.odometry is not None]
    origins = [origin_note(name, facts) for name, facts in posed]
    # Also of poses that an earlier build computed: it may have ended before it published its notes.
    doubts = [note for name, facts in posed for note in doubt_notes(name, facts)]
    return drives, (*origins, *doubts, *notes)


def _lacks_poses(drive: StoredDrive) -> bool:
    if len(drive) < LEAST_SCANS:
        return False
    if drive.odometry is not None:
        return drive.odometry.get("scans") != _scans_digest(drive)
    return not is_known(drive.poses).any()


def _scans_digest(drive: StoredDrive) -> str:
    """Return the digest of the scans that poses are computed of."""
    facts = [
        f"{at} {digest}"
        for at, digest in zip(drive.scan_index.tolist(), drive.digests, strict=True)
    ]
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()
