"""Scans that are put into a drive: which may be, and what comes of each."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.errors import InvalidParameters
from core.scans.pose import is_known
from core.scans.scan import Scan
from core.scans.trajectory import SCAN_INDEX_LIMIT
from storage.catalog import ScanPoses, ScanRecord
from storage.catalog.put_target import PutTarget
from storage.errors import DriveClosed, ScanConflict

MOST_SCANS = 10**9
"""Most scans of a drive: new scans have smaller indices. At 20 Hz that is a year and a half without
a stop; a larger number is a time, or a mistake."""


@dataclass(frozen=True)
class PutResult:
    """The result of putting a scan.

    Attributes:
        created: False if the same content was stored already.
        record: What is stored.
        drive_id: Id of its drive.
    """

    created: bool
    record: ScanRecord
    drive_id: str


def check_indices(indices: Sequence[int]) -> None:
    """Raise `InvalidParameters` if one of these is no index of a scan, or is given twice."""
    for index in indices:
        if not 0 <= index < SCAN_INDEX_LIMIT:
            raise InvalidParameters(f"the scan index is {index}, wanted 0 <= index < 2**53")
    if len(set(indices)) != len(indices):
        raise InvalidParameters("a scan index is given twice")


def require_plausible(fresh: Sequence[tuple[int, Scan]]) -> None:
    """Raise `InvalidParameters` if the index of a new scan is too large for one."""
    for index, _ in fresh:
        if index >= MOST_SCANS:
            raise InvalidParameters(
                f"the scan index is {index}, wanted less than {MOST_SCANS}: is it a time? Number"
                " the scans in their order, or send them in an archive, named by their times"
            )


def beyond_last(poses: ScanPoses) -> list[int]:
    """Return the scans of known poses or times that are none unless they are stored already."""
    known = is_known(poses.poses) | np.isfinite(poses.timestamps_s)
    found: list[int] = poses.scans[known & (poses.scans >= MOST_SCANS)].tolist()
    return found


def refusal_of(target: PutTarget, index: int, digest: str) -> ScanConflict | DriveClosed | None:
    """Return why a scan of this digest cannot be put, `None` if it can or is stored."""
    stored = target.stored.get(index)
    if stored is None:
        if not target.closed:
            return None
        return DriveClosed(f"drive {target.drive_slug!r} is closed and has no scan {index}")
    if stored.digest == digest:
        return None
    return ScanConflict(
        f"scan {index} of drive {target.drive_slug!r} is stored with digest {stored.digest}, the"
        f" one put has {digest}: a stored scan is neither replaced nor removed by itself, only with"
        " its drive"
    )


def new_record(chunk: str, row: int, index: int, scan: Scan, digest: str) -> ScanRecord:
    """Return what the catalog keeps of a new scan."""
    return ScanRecord(
        index=index,
        chunk=chunk,
        row=row,
        digest=digest,
        returns=len(scan),
        dropped_returns=scan.dropped_returns,
        timestamp_s=scan.timestamp_s,
        pose=scan.pose,
    )
