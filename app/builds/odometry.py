"""Odometry of drives without poses, as a part of their builds."""

import hashlib
import logging
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from core.odometry.odometry import Odometry, compute_odometry
from core.odometry.posed_drive import PosedDrive
from core.odometry.registration import library_version
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive, scan_index_of
from core.scans.pose import is_known
from storage.catalog import ScanPoses
from storage.store import Store, StoredDrive

_LEAST_SCANS = 2
_NAMED = 5  # scans in a note
_LEAST_PATH_M = 1.0  # of a drive; less may be noise of scans that show no motion
_INSTALL = "`pip install ./clients/python '.[odometry]'` in the clone of the service"
_MISSING = f"put poses, or install the extra `odometry`, which computes missing poses: {_INSTALL}"

_log = logging.getLogger("tensormap.jobs")


def report_missing() -> None:
    """Log once, at the start of a service, that no poses can be computed, if so."""
    if library_version() is None:
        _log.info(
            "builds cannot compute the poses of drives without any: for that, install the extra"
            " `odometry`: %s",
            _INSTALL,
        )


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
        height_m = sensor_height_m if drive.mounting is None else drive.mounting.z_m
        if not _lacks_poses(drive):
            continue
        if not drive.has_returns.all():
            gone = int((~drive.has_returns).sum())
            notes.append(
                f"{_unposed(drive)}: odometry wants the returns of all scans, those of {gone} of"
                f" {len(drive)} were dropped after a build"
            )
            continue
        if library_version() is None:
            notes.append(f"{_unposed(drive)}: {_MISSING}")
            continue
        found = compute_odometry(drive, height_m, progress)
        if not found.usable:
            notes.append(_failure(drive, found))
            continue
        facts = {**found.facts, "scans": _scans_digest(drive)}
        poses = ScanPoses(drive.scan_index, found.poses, np.full(len(drive), np.nan), found.sigmas)
        changed = True
        if store.drives.set_computed_poses(drive.id, poses, facts):
            notes += _doubts(drive, found)
        else:
            notes.append(
                f"drive {drive.name}: it was changed while odometry computed its poses: they are"
                " not used"
            )
    if changed:
        drives = store.drives.open_of_map(map_id, [drive.name for drive in drives])
        came = (d for d in drives if d.odometry is not None and _lacks_poses(d))
        notes += [f"{_unposed(drive)}: build again when it is whole" for drive in came]
    origins = [_origin(d.name, d.odometry) for d in drives if d.odometry is not None]
    return drives, (*origins, *notes)


def pose_recorded(
    drive: Drive, sensor_height_m: float, progress: Progress = NO_PROGRESS
) -> tuple[Drive, tuple[str, ...]]:
    """Return a recorded drive, with computed poses if it has none, and notes on these.

    Args:
        drive: The drive as its sensor recorded it.
        sensor_height_m: Above ground.
        progress: Receives the stages.
    """
    if is_known(drive.poses).any() or len(drive) < _LEAST_SCANS:
        return drive, ()
    if library_version() is None:
        return drive, (f"{_unposed(drive)}: {_MISSING}",)
    found = compute_odometry(drive, sensor_height_m, progress)
    if not found.usable:
        return drive, (_failure(drive, found),)
    notes = (_origin(drive.name, found.facts), *_doubts(drive, found))
    return PosedDrive(drive, found.poses), notes


def _origin(name: str, facts: Mapping[str, Any]) -> str:
    text = (
        f"drive {name}: poses by odometry ({facts['registration']}) over {facts['path_m']:g} m,"
        f" with {facts['closures']} loop closures; standard deviation up to {facts['sigma_m']:g} m"
    )
    if facts["path_m"] >= _LEAST_PATH_M:
        return text
    return (
        f"{text}: the scans show hardly any motion: did the vehicle stand, or are they in the"
        " frame of a map, as clouds that SLAM has registered, and not in the sensor's?"
    )


def _failure(drive: Drive, found: Odometry) -> str:
    lost = len(drive) - found.fitting
    return (
        f"{_unposed(drive)}: odometry found none, {lost} of {len(drive)} scans do not fit those"
        " before them, or have too few returns"
    )


def _unposed(drive: Drive) -> str:
    """Return how much of a drive has no pose, and what that means."""
    unknown = int(np.count_nonzero(~is_known(drive.poses)))
    if unknown == len(drive):
        return f"drive {drive.name} has no poses, everything is in scan indices, no metres"
    return f"drive {drive.name}: {unknown} of {len(drive)} scans have no pose"


def _doubts(drive: Drive, found: Odometry) -> list[str]:
    """Return a note on scans that do not fit those before them, if there are any."""
    if not found.lost:
        return []
    scans = scan_index_of(drive)[list(found.lost[:_NAMED])].tolist()
    return [
        f"drive {drive.name}: {len(found.lost)} scans do not fit those before them, as"
        f" {', '.join(map(str, scans))}: is something missing? poses there are guesses"
    ]


def _lacks_poses(drive: StoredDrive) -> bool:
    if len(drive) < _LEAST_SCANS:
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
