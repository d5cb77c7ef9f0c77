"""Accumulation: consecutive scans of a sparse sensor become one, in the frame of the last.

Each is placed by its pose; a scan's own motion is not compensated, and what moves is seen several
times.
"""

from collections.abc import Sequence

import numpy as np

from core.arrays import FloatArray, IntArray, frozen
from core.errors import InvalidParameters, InvalidScan
from core.scans.drive import Drive, scan_index_of
from core.scans.pose import is_known
from core.scans.scan import Scan

MOST_SCANS = 64
"""Most scans that become one: 6 s at ten scans a second."""
MOST_RETURNS = 2**22
"""Most returns of all of them, as of the largest single scan that is read."""
FARTHEST_M = 100.0
"""Farthest scan from the last one: beyond, it is another place, or in another frame."""


def accumulate(scans: Sequence[Scan], poses: FloatArray) -> Scan:
    """Return several scans as one, in the frame of the last and with its time and pose.

    Args:
        scans: The scans, at least one, the last one last; their returns stay in this order.
        poses: `(n, 7)` pose rows of the sensor in any frame common to the scans, as of odometry.

    Raises:
        InvalidScan: If a pose is unknown or too far from the last one, or there are too many scans
            or returns.

    Examples:
        The vehicle drives 1 m towards a post that stood 10 m ahead.

        >>> post = Scan.from_returns([[10.0, 0.0, 0.0]])
        >>> rows = np.array([[0.0, 0, 0, 0, 0, 0, 1], [1.0, 0, 0, 0, 0, 0, 1]])
        >>> accumulate([post, post], rows).points_m.tolist()
        [[9.0, 0.0, 0.0], [10.0, 0.0, 0.0]]
    """
    if not 1 <= len(scans) <= MOST_SCANS:
        raise InvalidScan(f"{len(scans)} scans are to become one, wanted 1 to {MOST_SCANS}")
    if poses.shape != (len(scans), 7):
        raise InvalidScan(f"poses have shape {poses.shape}, wanted ({len(scans)}, 7)")
    last = scans[-1]
    if len(scans) == 1:
        return last
    require_few_returns(sum(map(len, scans)))
    unknown = np.flatnonzero(~is_known(poses))
    if len(unknown):
        raise InvalidScan(
            f"scan {unknown[0]} of {len(scans)} that become one has no pose, wanted one of each"
        )
    apart_m = np.linalg.norm(poses[:, :3] - poses[-1, :3], axis=1)
    if apart_m.max() > FARTHEST_M:
        raise InvalidScan(
            f"scan {apart_m.argmax()} of {len(scans)} that become one is {apart_m.max():.4g} m from"
            f" the last one, wanted at most {FARTHEST_M:g}"
        )
    from scipy.spatial.transform import Rotation  # only several scans need it: decision 33

    to_last = Rotation.from_quat(poses[-1, 3:]).inv()
    turns = to_last * Rotation.from_quat(poses[:-1, 3:])
    shifts_m = to_last.apply(poses[:-1, :3] - poses[-1, :3])
    points_m = [
        turns[row].apply(scan.points_m.astype(np.float64)) + shifts_m[row]
        for row, scan in enumerate(scans[:-1])
    ]
    return Scan.from_returns(
        np.concatenate([*points_m, last.points_m]),
        timestamp_s=last.timestamp_s,
        pose=last.pose,
        dropped_returns=sum(scan.dropped_returns for scan in scans),
    )


def require_few_returns(returns: int) -> None:
    """Reject scans with more returns together than one may have.

    Raises:
        InvalidScan: If they have.
    """
    if returns > MOST_RETURNS:
        raise InvalidScan(
            f"the scans that become one have {returns} returns, wanted at most {MOST_RETURNS}"
        )


def accumulated_scan(drive: Drive, position: int, count: int) -> Scan:
    """Return a scan of a drive with the `count` - 1 before it as one.

    Raises:
        InvalidScan: If one of them cannot be used, or as `accumulate`.
    """
    window = range(max(0, position - count + 1), position + 1)
    return accumulate([drive.scan(at) for at in window], drive.poses[window.start : window.stop])


class AccumulatedDrive:
    """A drive each of whose scans is `count` consecutive ones of another; an `IndexedDrive`.

    No scan is in two of them, so that queries that are held out share no return with the map. Each
    has the number, time and pose of its last one; the last may have fewer than `count`.

    Args:
        drive: The drive.
        count: How many of its scans become one.

    Raises:
        InvalidParameters: If `count` is out of range.
    """

    def __init__(self, drive: Drive, count: int) -> None:
        require_count(count)
        ends = np.unique(np.append(np.arange(count, len(drive), count), len(drive))) - 1
        self._ends: IntArray = ends[ends >= 0]
        self.name = drive.name
        self.timestamp_s: FloatArray = frozen(drive.timestamp_s[self._ends], np.float64)
        self.poses: FloatArray = frozen(drive.poses[self._ends], np.float64)
        self.scan_index: IntArray = frozen(scan_index_of(drive)[self._ends], np.int64)
        self._drive, self._count = drive, count

    def __len__(self) -> int:
        return len(self._ends)

    def scan(self, index: int) -> Scan:
        """Read the scans that become scan `index`, and accumulate them.

        Raises:
            InvalidScan: If one of them cannot be used, or as `accumulate`.
        """
        end = int(self._ends[index])
        return accumulated_scan(self._drive, end, end - index * self._count + 1)


def require_count(count: int) -> None:
    """Reject a number of scans that cannot become one.

    Raises:
        InvalidParameters: If it is out of range.
    """
    if not 1 <= count <= MOST_SCANS:
        raise InvalidParameters(f"accumulate is {count}, wanted 1 to {MOST_SCANS} scans")
