"""The files beside the scans in a folder of KITTI odometry: times, poses and calibration."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from app.drives.pose_files import KITTI, MOST_LINES, read_poses, require_rising
from app.drives.tar_stream import TarMember
from core.arrays import FloatArray
from core.errors import InvalidPose, InvalidScan, TensorMapError
from core.scans.times import first_flawed, flaw_of_time
from core.text import count_of
from storage.catalog import PosesPut
from storage.errors import DriveNotFound, PosesDoNotFit, ReturnsGone, ScanNotFound
from storage.formats.drives.kitti_drive import lidar_to_camera
from storage.formats.drives.text_rows import line_numbers, lines_in, without_comments
from storage.formats.errors import MalformedDrive
from storage.store import Drives

TIMES, POSES, CALIBRATION = "times.txt", "poses.txt", "calib.txt"
SCANS = "velodyne"
_MOST_BYTES = {TIMES: 64 * MOST_LINES, POSES: 512 * MOST_LINES, CALIBRATION: 2**16}
"""Largest size of each file: lines of times take many times their bytes in memory."""
_GONE = (DriveNotFound, ScanNotFound)


class KittiFiles:
    """Times, poses and calibration of an upload, until its scans are stored."""

    def __init__(self) -> None:
        self._bodies: dict[str, bytes] = {}
        self._names: dict[str, str] = {}
        self._repeated: dict[str, str] = {}
        self.used = False
        """Whether `put` changed something."""

    def take(self, member: TarMember) -> bool:
        """Keep a file of an archive if it is one of these, and return whether it is."""
        name = PurePosixPath(member.name).name
        if name not in {TIMES, POSES, CALIBRATION} or isinstance(member.content, InvalidScan):
            return False
        known = self._names.get(name, member.name)
        if PurePosixPath(known) != PurePosixPath(member.name):
            self._repeated[name] = member.name
            return True
        self._bodies[name] = member.content[: _MOST_BYTES[name] + 1]  # longer ones are refused
        self._names[name] = member.name
        return True

    def put(
        self,
        drives: Drives,
        map_slug: str,
        drive_slug: str,
        refuse: Callable[[str, TensorMapError], None],
        conflicting: Sequence[str] = (),
        drive_id: str | None = None,
    ) -> PosesPut | None:
        """Set what the files hold, and return what the poses changed; `None` without poses.

        They are those of the scans that they come with: where other scans are stored, or the
        archive has such files of two drives, nothing is set.

        Args:
            drives: The drives of the store.
            map_slug: The map.
            drive_slug: The drive.
            refuse: Called with each file that cannot be used, and the reason.
            conflicting: The files of scans at whose indices other scans are stored.
            drive_id: Id of the drive that got the archive's scans, `None` without any.

        Raises:
            DriveNotFound: If that drive was deleted.
        """
        if drive_id is not None and self._bodies:
            drives.require_same(map_slug, drive_slug, drive_id)
        if conflicting:
            error = PosesDoNotFit(
                f"{len(conflicting)} scans of the archive, the first in {conflicting[0]}, are not"
                f" the stored ones of drive {drive_slug!r}: is this another drive? If not, put the"
                " poses alone"
            )
            self._refuse_all(error, refuse)
            return None
        for name, repeated in self._repeated.items():
            several = MalformedDrive(
                f"the archive has {self._names[name][:60]} and {repeated[:60]}: wanted one drive"
            )
            self._refuse_all(several, refuse)
            return None
        times_s = poses = put = None
        with self._refused(TIMES, refuse):
            if TIMES in self._bodies:
                times_s = _times(self._body(TIMES))
        with self._refused(POSES, refuse):
            if POSES in self._bodies:
                poses = read_poses(self._body(POSES), KITTI, to_camera=self._to_camera())
                if times_s is not None and len(times_s) == len(poses):
                    poses = replace(poses, timestamps_s=times_s)
                put = drives.expect_poses(
                    map_slug, drive_slug, poses, with_scans=True, drive_id=drive_id
                )
                self.used = True
        if POSES not in self._bodies and CALIBRATION in self._bodies:
            refuse(
                self._names[CALIBRATION], MalformedDrive("there is no poses.txt that it belongs to")
            )
        if times_s is not None and not (put and poses and poses.timestamps_s is times_s):
            with self._refused(TIMES, refuse):
                _put_times(drives, map_slug, drive_slug, times_s)
                self.used = True
        return put

    def _refuse_all(
        self, error: TensorMapError, refuse: Callable[[str, TensorMapError], None]
    ) -> None:
        for name in (*self._names.values(), *self._repeated.values()):
            refuse(name, error)

    def _to_camera(self) -> FloatArray | None:
        if CALIBRATION not in self._bodies:
            return None
        return lidar_to_camera(Path(CALIBRATION), lines_in(self._body(CALIBRATION)))

    def _body(self, name: str) -> bytes:
        body, most = self._bodies[name], _MOST_BYTES[name]
        if len(body) > most:
            raise MalformedDrive(f"{name} has more than {most} bytes, which are read at most")
        return body

    @contextmanager
    def _refused(self, file: str, refuse: Callable[[str, TensorMapError], None]) -> Iterator[None]:
        try:
            yield
        except (InvalidPose, MalformedDrive, PosesDoNotFit, ReturnsGone, *_GONE) as error:
            refuse(self._names[file], error)


def _put_times(drives: Drives, map_slug: str, drive_slug: str, times_s: FloatArray) -> None:
    """Set the known times of stored scans; the file must have a line of each."""
    stored = drives.open(map_slug, drive_slug).scan_index.tolist()
    if stored and stored[-1] >= len(times_s):
        raise InvalidPose(
            f"it has {count_of(len(times_s), 'line')}, drive {drive_slug!r} has scans up to"
            f" {stored[-1]}"
        )
    known = {index: float(times_s[index]) for index in stored if np.isfinite(times_s[index])}
    drives.put_poses(map_slug, drive_slug, {}, known)


def _times(body: bytes) -> FloatArray:
    """Return the seconds of each line, NaN where unknown; a `#` begins a comment.

    Raises:
        InvalidPose: If there are too many, one is no time in seconds, or they fall.
        MalformedDrive: If a line is no number.
    """
    all_lines = lines_in(body)
    if len(all_lines) > MOST_LINES:
        raise InvalidPose(f"the file has {len(all_lines)} lines, at most {MOST_LINES} are read")
    lines = without_comments(all_lines)
    seconds = [line_numbers(Path(TIMES), number, line, 1)[0] for number, line in lines]
    times_s = np.array(seconds, dtype=np.float64)
    known = np.isfinite(times_s)
    times_s[~known] = np.nan
    wrong = first_flawed(times_s)
    if wrong is not None:
        raise InvalidPose(f"line {lines[wrong][0]}: the time is {flaw_of_time(times_s[wrong])}")
    require_rising(np.flatnonzero(known), times_s[known])
    return times_s
