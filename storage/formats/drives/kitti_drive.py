"""Drives in the layout of KITTI odometry: `velodyne/`, `times.txt`, `poses.txt`, `calib.txt`.

KITTI's poses are those of camera 0 (x right, y down, z forward) in the world that is camera 0's
own frame at the first scan. `Tr` in `calib.txt` takes lidar coordinates to camera coordinates. A
point p of the lidar at scan i is Tr p in camera i, T_i Tr p in the camera world and

    Tr^-1 T_i Tr p

in the lidar's frame at the first scan: x forward, y left, z up. Without `calib.txt` the poses are
the lidar's already; drives are written so.
"""

import errno
import re
import shutil
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from core.arrays import FloatArray
from core.errors import EmptyDrive, InvalidPose
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive
from core.scans.pose import UNKNOWN_POSE, Pose, is_known, matrices_from_rows, rows_from_matrices
from core.text import count_of
from storage.files.files import hidden_beside, named_disk_errors
from storage.formats.drives.file_drive import FileDrive, in_time_order
from storage.formats.drives.text_rows import TUM_COLUMNS, line_numbers, lines_of, without_comments
from storage.formats.errors import MalformedDrive
from storage.formats.scans.file_names import time_s_of
from storage.formats.scans.kitti import kitti_body
from storage.formats.scans.registry import is_scan_file, suffix_of

_NUMBER = re.compile(r"\d+", re.ASCII)
_RAW_FOLDERS = ("velodyne_points", "data")  # of a drive of KITTI's raw data


def open_kitti_drive(path: Path, *, min_returns: int = 1) -> FileDrive:
    """Open a drive of `velodyne/*.bin`; all the files beside it are optional.

    Raises:
        EmptyDrive: If there are no scans.
        MalformedDrive: If times, poses or calibration do not parse or do not fit the scans, as
            where a number is missing between those that are the scans' names.
    """
    shown = (path / "velodyne").glob("[!.]*")
    files = tuple(file for file in shown if file.suffix.lower() == ".bin")
    if not files:
        raise EmptyDrive(f"{path / 'velodyne'} has no scan files *.bin")
    return _drive(path, files, min_returns)


def open_scan_folder(path: Path, *, min_returns: int = 1) -> FileDrive:
    """Open a flat folder of scan files of any format; the files beside them are KITTI's.

    The folder's name is the drive's; that of `DRIVE/velodyne_points/data`, of KITTI's raw data, is
    that of DRIVE.

    Raises:
        EmptyDrive: If it holds no scan file.
        MalformedDrive: If some names are times and others are not, or two are the same time or
            differ in their suffixes only, or as of `open_kitti_drive`.
    """
    # A link that leads nowhere is a scan that cannot be read, and is not passed over.
    files = tuple(file for file in path.iterdir() if is_scan_file(file) and not file.is_dir())
    _require_each_once(path, files)
    return _drive(path, files, min_returns, _raw_name(path.resolve()))


def _raw_name(folder: Path) -> str:
    """Return the name of the drive of KITTI's raw data that a folder is of, empty if of none."""
    is_raw = folder.parts[-2:] == _RAW_FOLDERS
    return folder.parents[1].name if is_raw else ""


def _require_each_once(path: Path, files: Sequence[Path]) -> None:
    """Reject a scan in two formats: held out of a map, it would be in the map all the same."""
    by_stem: dict[str, Path] = {}
    for file in sorted(files):
        earlier = by_stem.setdefault(_stem(file), file)
        if earlier is not file:
            raise MalformedDrive(
                f"{path} has a scan twice, as {earlier.name} and {file.name}: wanted one format"
            )


def _stem(file: Path) -> str:
    return file.name[: -len(suffix_of(file.name))]


def _drive(path: Path, files: Iterable[Path], min_returns: int, name: str = "") -> FileDrive:
    files, named_s = in_time_order(files)
    times = path / "times.txt"
    return FileDrive(
        name or path.resolve().name,
        files,
        _times_s(times, files) if files and times.exists() else named_s,
        _poses(path / "poses.txt", path / "calib.txt", files),
        min_returns,
    )


def write_kitti_drive(drive: Drive, path: str | Path, progress: Progress = NO_PROGRESS) -> None:
    """Write a drive as a new folder, whole or not at all; `open_kitti_drive` reads it back.

    Reflectances are 0. Poses are the lidar's own, so no `calib.txt` is written; unknown values are
    `nan`, and a file that would have no other is not written.

    Args:
        drive: What to write.
        path: A folder that is empty or does not exist; its parent does.
        progress: Reports each scan.

    Raises:
        FileExistsError: If something is at `path` already.
        InvalidScan: If a scan of the drive cannot be read.
        StorageFull: If no space is left.
    """
    path = Path(path)
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise FileExistsError(errno.EEXIST, "it exists and is no empty folder", str(path))
    whole = path.resolve()  # `.` has no name
    part = hidden_beside(whole)
    progress.start("writing", len(drive))
    try:
        with named_disk_errors(f"the folder of {path}"):
            (part / "velodyne").mkdir(parents=True)
            for index in range(len(drive)):
                file = part / "velodyne" / f"{index:06d}.bin"
                file.write_bytes(kitti_body(drive.scan(index)))
                progress.advance()
            if np.isfinite(drive.timestamp_s).any():
                _write_numbers(part / "times.txt", drive.timestamp_s[:, None])
            if is_known(drive.poses).any():
                matrices = matrices_from_rows(drive.poses)[:, :3]
                _write_numbers(part / "poses.txt", matrices.reshape(-1, 12))
            part.rename(whole)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _write_numbers(file: Path, rows: FloatArray) -> None:
    lines = (" ".join(map(repr, row)) for row in rows.tolist())
    file.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def camera_to_lidar_poses(camera_poses: FloatArray, lidar_to_camera: FloatArray) -> FloatArray:
    """Convert poses of the camera in its own world to poses of the lidar in its own.

    Args:
        camera_poses: `(n, 3, 4)` or `(n, 4, 4)`, camera to camera world; NaN where unknown.
        lidar_to_camera: `(3, 4)` or `(4, 4)`, KITTI's `Tr`.

    Returns:
        `(n, 4, 4)`, lidar to a world with x forward, y left, z up.

    Examples:
        The camera looks along the lidar's x axis and moves 5 m forward, its z.

        >>> Tr = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0]], dtype=float)
        >>> forward = np.eye(4)[None]
        >>> forward[0, 2, 3] = 5.0
        >>> camera_to_lidar_poses(forward, Tr)[0, :3, 3].tolist()
        [5.0, 0.0, 0.0]
    """
    to_camera = _homogeneous(lidar_to_camera)
    return np.asarray(np.linalg.inv(to_camera) @ _homogeneous(camera_poses) @ to_camera)


def _homogeneous(matrices: FloatArray) -> FloatArray:
    whole = np.broadcast_to(np.eye(4), (*matrices.shape[:-2], 4, 4)).copy()
    whole[..., :3, :] = matrices[..., :3, :]
    return whole


def _times_s(file: Path, scans: Sequence[Path]) -> FloatArray:
    lines = without_comments(lines_of(file))
    times_s: FloatArray = _numbers(file, lines, columns=1)[:, 0]
    _require_line_a_scan(file, scans, lines, "time")
    return times_s


def _poses(file: Path, calibration: Path, scans: Sequence[Path]) -> FloatArray:
    if not (scans and file.exists()):
        return np.full((len(scans), 7), UNKNOWN_POSE)
    lines = without_comments(lines_of(file))
    _require_kittis(file, lines)
    matrices = _numbers(file, lines, columns=12).reshape(-1, 3, 4)
    _require_line_a_scan(file, scans, lines, "pose")
    known = np.isfinite(matrices).all(axis=(1, 2))
    matrices[~known] = np.nan  # also a pose that is known in part
    try:
        rows = rows_from_matrices(matrices)
    except InvalidPose:  # one by one, which takes a hundred times as long, only to name the line
        for index in np.flatnonzero(known).tolist():
            _require_rotation(file, lines[index][0], matrices[index])
        raise
    if not calibration.exists():
        return rows
    to_camera = lidar_to_camera(calibration, lines_of(calibration))
    try:
        return rows_from_matrices(camera_to_lidar_poses(matrices, to_camera))
    except InvalidPose as error:  # each is nearly a rotation, their product is not
        raise MalformedDrive(f"{file.name} and {calibration.name} together: {error}") from error


def _require_kittis(file: Path, lines: Sequence[tuple[int, str]]) -> None:
    number, first = lines[0] if lines else (1, "")
    if len(first.split()) == TUM_COLUMNS:
        raise MalformedDrive(
            f"{file.name}, line {number}: {TUM_COLUMNS} values, TUM's `t x y z qx qy qz qw`, wanted"
            " KITTI's 12, `[R | t]` by rows: convert the file; or upload the drive without it, and"
            " put it as application/vnd.tensormap.poses.tum"
        )


def _require_rotation(file: Path, number: int, matrix: FloatArray) -> None:
    try:
        Pose.from_matrix(matrix)
    except InvalidPose as error:
        raise MalformedDrive(f"{file.name}, line {number}: {error}") from error


def lidar_to_camera(file: Path, lines: Iterable[str]) -> FloatArray:
    """Return the `Tr` of a calibration, `(3, 4)`.

    Args:
        file: The file's name, for messages.
        lines: What it holds.

    Raises:
        MalformedDrive: If it has none, or one that is no rigid motion.
    """
    for number, line in enumerate(lines, start=1):
        key, _, values = line.partition(":")
        if key.strip() == "Tr":
            matrix = line_numbers(file, number, values, columns=12).reshape(3, 4)
            _require_rotation(file, number, matrix)
            return matrix
    raise MalformedDrive(
        f"{file.name} has no line 'Tr:' of 12 numbers, lidar to camera 0; without the file the"
        " poses are the lidar's own"
    )


def _numbers(file: Path, lines: Sequence[tuple[int, str]], columns: int) -> FloatArray:
    """Return the numbers of numbered lines of a text file, `(lines, columns)`."""
    rows = [line_numbers(file, number, line, columns) for number, line in lines]
    return np.array(rows, dtype=np.float64).reshape(len(rows), columns)


def _require_line_a_scan(
    file: Path, scans: Sequence[Path], lines: Sequence[tuple[int, str]], what: str
) -> None:
    gap = _gap(scans)
    if len(lines) != len(scans):
        where = f": {gap}; wanted a line a scan, or no {file.name}" if gap else ""
        last = lines[-1][0] if lines else 0
        beside = "" if last == len(lines) else f" with {count_of(len(lines), what)}"
        raise MalformedDrive(
            f"{file.name} ends at line {last}{beside}, the drive has"
            f" {count_of(len(scans), 'scan')}{where}"
        )
    if gap:  # which line is whose is not known
        raise MalformedDrive(
            f"{file.name} has a line for each of {count_of(len(scans), 'scan')}, but {gap}: wanted"
            f" scans of consecutive numbers, or no {file.name}"
        )


def _gap(scans: Sequence[Path]) -> str | None:
    """Return where numbers of scans are missing between others, in words."""
    numbered = all(_NUMBER.fullmatch(_stem(scan)) for scan in scans)
    if not numbered or time_s_of(scans[0].name) is not None:
        return None
    for earlier, later in pairwise(scans):
        if int(_stem(later)) > int(_stem(earlier)) + 1:
            return f"scan {earlier.name} is followed by {later.name}"
    return None
