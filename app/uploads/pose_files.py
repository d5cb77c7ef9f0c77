"""Poses as files have them: KITTI, TUM and CSV."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from core.errors import InvalidPose
from core.pose import Pose

__all__ = ["CSV", "KITTI", "POSE_TYPES", "TUM", "PoseFile", "read_poses"]

KITTI = "application/vnd.tensormap.poses.kitti"
TUM = "application/vnd.tensormap.poses.tum"
CSV = "application/vnd.tensormap.poses.csv"
POSE_TYPES = {
    KITTI: "KITTI: a line a scan, the 12 numbers of `[R | t]`, lidar to world; `nan` where unknown",
    TUM: "TUM: a line a scan, `t x y z qx qy qz qw`; `#` begins a comment",
    CSV: "CSV with the columns `scan,x,y,z,qx,qy,qz,qw` and, if known, `timestamp_s`, in any order",
}
_MOST_LINES = 1_000_000
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_LAST_INDEX = 2**53


@dataclass(frozen=True)
class PoseFile:
    """What a file says about the scans of a drive.

    Attributes:
        poses: Sensor to world by scan index, `None` where unknown.
        timestamps_s: Seconds by scan index.
    """

    poses: dict[int, Pose | None] = field(default_factory=dict)
    timestamps_s: dict[int, float] = field(default_factory=dict)


def read_poses(body: bytes, media_type: str, first: int = 0) -> PoseFile:
    """Read a file of poses.

    Args:
        body: The file.
        media_type: One of `POSE_TYPES`.
        first: The scan of the first line, of a file that names none.

    Raises:
        InvalidPose: If a line is none; the message says which.

    Examples:
        >>> read_poses(b"12.5 1 2 3 0 0 0 1", TUM, first=7).timestamps_s
        {7: 12.5}
    """
    found = PoseFile()
    read = {KITTI: _kitti, TUM: _tum, CSV: _csv}[media_type]
    for number, scan, timestamp_s, pose in read(_lines(body), first):
        if not 0 <= scan < _LAST_INDEX or scan in found.poses:
            raise InvalidPose(f"line {number}: scan {scan} comes twice or is no index")
        found.poses[scan] = pose
        if math.isfinite(timestamp_s):
            found.timestamps_s[scan] = timestamp_s
    if not found.poses:
        raise InvalidPose("the file has no line with a pose")
    _require_rising(found.timestamps_s)
    return found


def _require_rising(timestamps_s: dict[int, float]) -> None:
    """Refuse times that fall from one scan to the next: lines of another order are other scans'."""
    scans = sorted(timestamps_s)
    falls = np.flatnonzero(np.diff([timestamps_s[scan] for scan in scans]) < 0.0)
    if len(falls):
        before, scan = scans[falls[0]], scans[falls[0] + 1]
        raise InvalidPose(
            f"scan {scan} is of {timestamps_s[scan]:.3f} s, before scan {before} of"
            f" {timestamps_s[before]:.3f} s: wanted times that rise with the scans"
        )


_Row = tuple[int, int, float, Pose | None]
_Lines = Iterator[tuple[int, str]]


def _kitti(lines: _Lines, first: int) -> Iterator[_Row]:
    for position, (number, line) in enumerate(lines):
        values = _numbers(number, line.split(), 12)
        matrix = np.array(values).reshape(3, 4)
        pose = None
        if np.isfinite(matrix).all():
            try:
                pose = Pose.from_matrix(matrix)
            except InvalidPose as error:
                raise InvalidPose(f"line {number}: {error}") from error
        yield number, first + position, math.nan, pose


def _tum(lines: _Lines, first: int) -> Iterator[_Row]:
    for position, (number, line) in enumerate(lines):
        timestamp_s, *values = _numbers(number, line.split(), 8)
        yield number, first + position, timestamp_s, _pose(number, values)


def _csv(lines: _Lines, first: int) -> Iterator[_Row]:
    del first  # a column has the index
    number, head = next(lines, (1, ""))
    names = [name.strip().strip('"').lower() for name in head.split(",")]
    wanted = ("scan", *_POSE)
    if not set(wanted) <= set(names) or len(set(names)) != len(names):
        raise InvalidPose(f"line {number} is {head[:120]!r}, wanted columns {','.join(wanted)}")
    for number, line in lines:
        row = dict(zip(names, line.split(","), strict=False))
        if len(row) != len(names) or line.count(",") != len(names) - 1:
            raise InvalidPose(f"line {number} has not the {len(names)} columns of the first")
        scan = row["scan"].strip()
        if not (scan.isascii() and scan.isdecimal() and len(scan) <= 16):
            raise InvalidPose(f"line {number}: scan is {scan[:40]!r}, wanted an index")
        (timestamp_s,) = _numbers(number, [row.get("timestamp_s", "").strip() or "nan"], 1)
        values = _numbers(number, [row[name].strip() or "nan" for name in _POSE], 7)
        yield number, int(scan), timestamp_s, _pose(number, values)


def _pose(number: int, values: list[float]) -> Pose | None:
    if not all(map(math.isfinite, values)):
        return None
    try:
        return Pose(*values)
    except InvalidPose as error:
        raise InvalidPose(f"line {number}: {error}") from error


def _numbers(number: int, words: list[str], count: int) -> list[float]:
    if len(words) != count:
        raise InvalidPose(f"line {number} has {len(words)} values, wanted {count}")
    try:
        return [float(word) for word in words]
    except ValueError as error:
        raise InvalidPose(f"line {number}: {str(error)[:120]}") from error


def _lines(body: bytes) -> _Lines:
    """Give the lines that say something, with their numbers."""
    text = body.removeprefix(b"\xef\xbb\xbf")
    for number, line in enumerate(text.splitlines(), start=1):
        if number > _MOST_LINES:
            raise InvalidPose(f"the file has more than {_MOST_LINES} lines")
        told = line.decode("utf-8", "replace").partition("#")[0].strip()
        if told:
            yield number, told
