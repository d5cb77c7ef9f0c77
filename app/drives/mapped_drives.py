"""Stored drives and scans as maps are built of them: accumulated, and in the vehicle's frame."""

import hashlib
from collections.abc import Sequence
from functools import cache, partial

import numpy as np

from core.arrays import FloatArray
from core.scans.accumulation import accumulated_scan
from core.scans.drive import Drive
from core.scans.mounting import vehicle_drive
from core.scans.pose import digest_of_poses
from core.scans.scan import Scan
from storage.catalog import DriveRecord
from storage.errors import ScanNotFound
from storage.store import Store, StoredDrive


def mapped_drive(drive: StoredDrive, sensor_height_m: float) -> Drive:
    """Return a stored drive as a map of that sensor height is built of it."""
    return vehicle_drive(drive, drive.mounting, sensor_height_m, drive.accumulate)


class StoredScans:
    """Single scans of a map's drives, likewise; each drive is looked up once.

    Args:
        store: The drives' store.
        map_slug: The map.
        sensor_height_m: The sensor height of the map's images.
    """

    def __init__(self, store: Store, map_slug: str, sensor_height_m: float) -> None:
        self._get = cache(partial(store.drives.find, map_slug))
        self._open = cache(partial(store.drives.open, map_slug))  # reads the facts of all its scans
        self._read = partial(store.drives.read_scan, map_slug)
        self._sensor_height_m = sensor_height_m

    def scan(self, drive_slug: str, index: int) -> Scan:
        """Read a scan, and those stored before it that become one with it.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
            ScanNotFound: If the drive has no such scan.
            ReturnsGone: If the returns of one were dropped after a build.
            CorruptFile: If a stored scan is not the one that was put.
            InvalidScan: If they cannot become one.
        """
        record = self._get(drive_slug)
        if record.accumulate == 1:
            scan = self._read(drive_slug, index)
        else:
            drive = self._open(drive_slug)
            position = int(np.searchsorted(drive.scan_index, index))
            if position == len(drive) or drive.scan_index[position] != index:
                raise ScanNotFound(f"drive {drive_slug!r} has no scan {index}")
            scan = accumulated_scan(drive, position, record.accumulate)
        return (
            scan if record.mounting is None else record.mounting.mount(scan, self._sensor_height_m)
        )


def mapped_digest(drive: StoredDrive, sensor_height_m: float) -> str:
    """Return the digest of all that its images depend on besides how a map's are made."""
    poses = None if drive.accumulate == 1 else drive.poses
    return digest_of(drive.record, drive.digests, poses, sensor_height_m)


def digest_of(
    drive: DriveRecord,
    digests: Sequence[str],
    poses: FloatArray | None,
    sensor_height_m: float,
) -> str:
    """Return that digest of a drive that need not be open.

    Args:
        drive: The drive.
        digests: Those of its scans, in the order of their indices.
        poses: `(K, 7)` those of its scans, `None` unless several scans become one.
        sensor_height_m: The sensor height of the map's images.
    """
    facts = list(digests)
    if drive.mounting is not None:
        facts.append(f"mounting {drive.mounting}, {sensor_height_m!r} above ground")
    if poses is not None:
        facts.append(f"accumulate {drive.accumulate} {digest_of_poses(poses)}")
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()
