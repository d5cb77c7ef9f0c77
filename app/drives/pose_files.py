"""Files of poses: KITTI, TUM and CSV, read in blocks of lines."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from core.arrays import FloatArray, IntArray
from core.errors import InvalidPose
from core.scans.pose import UNKNOWN_POSE, Pose, first_invalid, is_known, rows_from_matrices
from core.scans.times import decreasing_rows, first_flawed, flaw_of_time
from core.scans.trajectory import SCAN_INDEX_LIMIT
from storage.catalog import ScanPoses
from storage.formats.drives.kitti_drive import camera_to_lidar_poses
from storage.formats.drives.text_rows import TUM_COLUMNS
from storage.formats.scans.text_numbers import blocks_of_lines, number_rows, wrong_line

KITTI = "application/vnd.tensormap.poses.kitti"
TUM = "application/vnd.tensormap.poses.tum"
CSV = "application/vnd.tensormap.poses.csv"
POSE_TYPES = {
    KITTI: "KITTI: a line a scan, the 12 numbers of `[R | t]`, lidar to world; `nan` where unknown,"
    " and no blank line",
    TUM: "TUM: a line a scan, `t x y z qx qy qz qw`; `#` begins a comment",
    CSV: "CSV with the columns `scan,x,y,z,qx,qy,qz,qw` and, if known, `timestamp_s`, in any order",
}
MOST_LINES = 72_000  # 2 hours at 10 Hz; to read, compare and store one takes up to 50 us
_MOST_LINE_BYTES = 2**16
_MOST_COLUMNS = 64
_KITTI_COLUMNS = 12
_BLOCK_BYTES = 2**20
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_COMMENT = re.compile(rb"#[^\n]*")
_BLANK_LINE = re.compile(rb"(?m)^[ \t]*\n")
_BLANK_BETWEEN = re.compile(rb"(?:\n|\A)([ \t\r]*)\n")
_NOTHING = re.compile(rb"(?<![^,\n])[ \t]*(?=[,\n])")


@dataclass(frozen=True)
class _Rows:
    """Some lines: the scan of each, `(n,)`, -1 if the line number gives it; seconds; poses."""

    scans: IntArray
    timestamps_s: FloatArray
    poses: FloatArray


def read_poses(
    body: bytes, media_type: str, first: int = 0, *, to_camera: FloatArray | None = None
) -> ScanPoses:
    """Read a file of poses.

    Args:
        body: The file.
        media_type: One of `POSE_TYPES`.
        first: The scan of the first line, if the file names no scans.
        to_camera: KITTI's `Tr`, `(3, 4)`, if the poses are the camera's.

    Raises:
        InvalidPose: If a line has no valid pose; the message names it.

    Examples:
        >>> found = read_poses(b"12.5 1 2 3 0 0 0 1", TUM, first=7)
        >>> found.scans.tolist(), found.timestamps_s.tolist()
        ([7], [12.5])
    """
    text = memoryview(body.removeprefix(b"\xef\xbb\xbf"))
    if media_type == KITTI:
        _require_no_blank_line(body)
    parts: list[_Rows] = []
    known: dict[str, Callable[[bytes], _Rows]] = {
        KITTI: partial(_kitti, to_camera=to_camera),
        TUM: _tum,
    }
    parse = known.get(media_type)
    number = 1
    for block in blocks_of_lines(text, _BLOCK_BYTES):
        if block is None:
            raise InvalidPose(f"line {number} has more than {_BLOCK_BYTES} bytes")
        if number + block.count(b"\n") - 1 > MOST_LINES:
            raise InvalidPose(f"the file has more than {MOST_LINES} lines")
        content = _COMMENT.sub(b"", block) if b"#" in block else block
        begin = number
        if parse is None:
            parse, content, begin = _table(content, number)
        parts.append(_block(parse, content, begin))
        number += block.count(b"\n")
    return _joined(parts, first)


def _require_no_blank_line(body: bytes) -> None:
    """Reject a blank line before others: passed over, later poses would be of other scans."""
    if found := _BLANK_BETWEEN.search(body.rstrip()):
        number = body.count(b"\n", 0, found.start(1)) + 1
        raise InvalidPose(
            f"line {number} is blank, wanted a line a scan, of nan where the pose is unknown"
        )


def _joined(parts: list[_Rows], first: int) -> ScanPoses:
    if not sum(len(part.scans) for part in parts):
        raise InvalidPose("the file has no line with a pose")
    scans = np.concatenate([part.scans for part in parts])
    if scans[0] < 0:  # given by the line number
        scans = first + np.arange(len(scans))
    beyond = (scans < 0) | (scans >= SCAN_INDEX_LIMIT)
    if beyond.any():
        raise InvalidPose(f"scan {scans[beyond.argmax()]} is no index")
    order = np.argsort(scans, kind="stable")
    scans = scans[order]
    twice = np.flatnonzero(np.diff(scans) == 0)
    if len(twice):
        raise InvalidPose(f"scan {scans[twice[0]]} comes twice")
    timestamps_s = np.concatenate([part.timestamps_s for part in parts])[order]
    known = np.isfinite(timestamps_s)
    poses = np.concatenate([part.poses for part in parts])[order]
    require_rising(scans[known], timestamps_s[known])
    return ScanPoses(scans, poses, np.where(known, timestamps_s, np.nan))


def require_rising(scans: IntArray, timestamps_s: FloatArray) -> None:
    """Reject times that fall from one scan to the next: the poses are in another order.

    Args:
        scans: `(n,)` those with a time, rising.
        timestamps_s: `(n,)` seconds.

    Raises:
        InvalidPose: Naming the first two such scans.
    """
    found = decreasing_rows(timestamps_s)
    if len(found):
        before, after = found[0] - 1, found[0]
        raise InvalidPose(
            f"scan {scans[after]} is of {timestamps_s[after]:.3f} s, before scan {scans[before]} of"
            f" {timestamps_s[before]:.3f} s: expected times that rise with the scans"
        )


def _block(parse: Callable[[bytes], _Rows], block: bytes, number: int) -> _Rows:
    """Read a block of whole lines; if one is wrong, find the first of them by bisection.

    Raises:
        InvalidPose: Naming the line.
    """
    try:
        return parse(block)
    except (InvalidPose, ValueError) as error:
        at, wrong = wrong_line(block, parse, error)
        raise InvalidPose(f"line {number + at}: {wrong}") from wrong


def _kitti(block: bytes, to_camera: FloatArray | None) -> _Rows:
    rows = _number_rows(block, _KITTI_COLUMNS, f"TUM's are {TUM}", TUM_COLUMNS)
    matrices = rows.reshape(-1, 3, 4)
    matrices[~np.isfinite(matrices).all(axis=(1, 2))] = np.nan
    poses = rows_from_matrices(matrices)
    if to_camera is not None:
        poses = rows_from_matrices(camera_to_lidar_poses(matrices, to_camera))
    return _checked(np.full(len(poses), -1), np.full(len(poses), np.nan), poses)


def _tum(block: bytes) -> _Rows:
    numbers = _number_rows(block, TUM_COLUMNS, f"KITTI's are {KITTI}", _KITTI_COLUMNS)
    return _checked(np.full(len(numbers), -1), numbers[:, 0], numbers[:, 1:])


def _number_rows(block: bytes, columns: int, hint: str, hint_columns: int) -> FloatArray:
    """Return lines of so many numbers; where they have those of the other type, with a hint at it.

    Raises:
        ValueError: If a line has another number of them, or something else.
    """
    try:
        return number_rows(block, range(columns), columns, None)
    except ValueError as error:
        if len(block.split(b"\n", 1)[0].split()) == hint_columns:
            raise InvalidPose(f"{error}; {hint}, with {hint_columns}") from error
        raise


def _table(block: bytes, number: int) -> tuple[Callable[[bytes], _Rows], bytes, int]:
    """Return a parser for a table's lines, those after its line of names, and their number."""
    begin = number
    head = b""
    while block and not head:
        head, _, block = block.partition(b"\n")
        head, number = head.strip(), number + 1
    text = head[:_MOST_LINE_BYTES].decode("utf-8", "replace")
    names = [name.strip().strip('"').lower() for name in text.split(",")]
    needed = ("scan", *_POSE)
    if not set(needed) <= set(names) or len(set(names)) != len(names) or len(names) > _MOST_COLUMNS:
        raise InvalidPose(
            f"line {max(number - 1, begin)} is {text[:120]!r}, wanted columns {','.join(needed)}"
        )
    columns = [names.index(name) for name in (*needed, "timestamp_s") if name in names]
    return partial(_table_rows, columns=columns, width=len(names)), block, number


def _table_rows(block: bytes, columns: list[int], width: int) -> _Rows:
    try:
        numbers = number_rows(block, columns, width, ",")
    except ValueError:  # perhaps because fields are empty
        filled = _NOTHING.sub(b"nan", _BLANK_LINE.sub(b"", block))
        numbers = number_rows(filled, columns, width, ",")
    scans = numbers[:, 0]
    if not ((scans >= 0) & (scans < SCAN_INDEX_LIMIT) & (scans == np.floor(scans))).all():
        raise InvalidPose("a scan is no index")
    has_times = len(columns) > 1 + len(_POSE)
    timestamps_s = numbers[:, 8] if has_times else np.full(len(numbers), np.nan)
    return _checked(scans.astype(np.int64), timestamps_s, numbers[:, 1:8])


def _checked(scans: IntArray, timestamps_s: FloatArray, poses: FloatArray) -> _Rows:
    """Reject invalid poses and times; incomplete poses are unknown."""
    poses = np.array(poses)
    poses[~is_known(poses)] = UNKNOWN_POSE
    wrong = first_invalid(poses)
    if wrong is not None:
        Pose(*poses[wrong].tolist())  # raises, and names what is wrong
    wrong = first_flawed(timestamps_s)
    if wrong is not None:
        raise InvalidPose(f"the time is {flaw_of_time(timestamps_s[wrong])}")
    return _Rows(scans, np.array(timestamps_s), poses)
