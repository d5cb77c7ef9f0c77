"""Stored drives and scans as maps are built of them: accumulated, and in the vehicle's frame."""

import hashlib

import numpy as np

from core.scans.drive import Drive
from core.scans.mounting import vehicle_drive, vehicle_scan
from core.scans.scan import Scan
from storage.errors import ScanNotFound
from storage.store import StoredDrive


def mapped_drive(drive: StoredDrive, sensor_height_m: float) -> Drive:
    """Return a stored drive as a map of that sensor height is built of it."""
    return vehicle_drive(drive, drive.mounting, sensor_height_m, drive.accumulate)


def mapped_scan(drive: StoredDrive, index: int, sensor_height_m: float) -> Scan:
    """Return the scan of an index likewise, with those stored before it that become one.

    Raises:
        ScanNotFound: If the drive has no such scan, or was deleted.
        ReturnsGone: If the returns of one were dropped after a build.
        CorruptFile: If a stored scan is not the one that was put.
        InvalidScan: If they cannot become one.
    """
    position = int(np.searchsorted(drive.scan_index, index))
    if position == len(drive) or drive.scan_index[position] != index:
        raise ScanNotFound(f"drive {drive.name!r} has no scan {index}")
    return vehicle_scan(drive, position, drive.mounting, sensor_height_m, drive.accumulate)


def mapped_digest(drive: StoredDrive, sensor_height_m: float) -> str:
    """Return the digest of all that its images depend on besides how a map's are made."""
    facts = list(drive.digests)
    if drive.mounting is not None:
        facts.append(f"mounting {drive.mounting}, {sensor_height_m!r} above ground")
    if drive.accumulate != 1:
        poses = hashlib.sha256(drive.poses.astype("<f8").tobytes()).hexdigest()
        facts.append(f"accumulate {drive.accumulate} {poses}")
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()
