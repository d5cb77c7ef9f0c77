"""Poses that a file gives at times of its own, and where the sensor was when a scan began."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from core.arrays import FloatArray, freeze
from core.errors import EmptyDrive, InvalidPose
from core.scans.pose import first_invalid, rows_from_matrices
from storage.formats.drives.file_drive import FileDrive, in_order
from storage.formats.drives.text_rows import line_numbers, lines_of
from storage.formats.errors import MalformedDrive

MAX_GAP_S = 1.0
"""Between two poses that are interpolated; EgoNN's tolerance for MulRan."""


@dataclass(frozen=True, eq=False)
class TimedPoses:
    """The poses of a trajectory at rising times.

    Attributes:
        name: The file's name, for messages.
        time_s: `(n,)`.
        rows: `(n, 7)` pose rows, all known.
    """

    name: str
    time_s: FloatArray
    rows: FloatArray

    def __post_init__(self) -> None:
        freeze(self, time_s=np.float64, rows=np.float64)
        if not len(self.time_s):
            raise MalformedDrive(f"{self.name} has no pose")
        wrong = first_invalid(self.rows)
        if wrong is not None:
            raise MalformedDrive(
                f"{self.name}: the pose at {self.time_s[wrong]:.3f} s is"
                f" {self.rows[wrong].tolist()}, wanted x y z in metres and a unit quaternion"
            )

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the poses at other times, `(k, 7)`: interpolated, the rotation along its arc.

        A pose is unknown (NaN) before the first time, after the last, and in a gap of more than
        `MAX_GAP_S`.

        Raises:
            MalformedDrive: If not one is known: the file is of another drive.
        """
        from scipy.spatial.transform import Rotation, Slerp  # only such drives need it

        found = np.full((len(time_s), 7), np.nan)
        after = np.searchsorted(self.time_s, time_s).clip(0, len(self.time_s) - 1)
        before = np.maximum(after - (self.time_s[after] > time_s), 0)
        inside = (time_s >= self.time_s[0]) & (time_s <= self.time_s[-1])
        inside &= self.time_s[after] - self.time_s[before] <= MAX_GAP_S
        if not inside.any():
            raise MalformedDrive(
                f"{self.name} has poses from {self.time_s[0]:.3f} s to {self.time_s[-1]:.3f} s, the"
                f" scans are from {np.min(time_s):.3f} s to {np.max(time_s):.3f} s: none is between"
                f" two poses at most {MAX_GAP_S:g} s apart"
            )
        for column in range(3):
            found[inside, column] = np.interp(time_s[inside], self.time_s, self.rows[:, column])
        rotations = Rotation.from_quat(self.rows[:, 3:])
        if len(rotations) == 1:
            found[inside, 3:] = self.rows[0, 3:]
        else:
            arc = Slerp(self.time_s, rotations)(time_s[inside])
            found[inside, 3:] = arc.as_quat(canonical=True)
        return found


def read_timed_poses(
    file: Path, *, columns: int, ticks_per_s: float, separator: str | None = None
) -> tuple[FloatArray, FloatArray]:
    """Read a file of a time and numbers a line; lines with a NaN or an empty value are left out.

    Args:
        file: What to read.
        columns: How many values a line has, the time included.
        ticks_per_s: Ticks of the time per second: 1e9 for nanoseconds.
        separator: The separator of the values; by default blanks.

    Returns:
        Rising times, `(n,)` seconds, each once, and the other numbers, `(n, columns - 1)`.

    Raises:
        MalformedDrive: If a line does not parse.
    """
    rows = np.array(
        [
            line_numbers(file, number, line, columns, separator)
            for number, line in enumerate(lines_of(file), 1)
        ]
    ).reshape(-1, columns)
    rows = rows[np.isfinite(rows).all(axis=1)]
    _, first = np.unique(rows[:, 0], return_index=True)
    rows = rows[first]
    return rows[:, 0] / ticks_per_s, rows[:, 1:]


def timed_poses(file: Path, time_s: FloatArray, matrices: FloatArray) -> TimedPoses:
    """Return the poses of `(n, 4, 4)` matrices, sensor to world.

    Raises:
        MalformedDrive: If one is no rotation, or there is none.
    """
    try:
        return TimedPoses(file.name, time_s, rows_from_matrices(matrices))
    except InvalidPose as error:
        raise MalformedDrive(f"{file.name}: {error}") from error


def open_stamped_drive(
    name: str,
    folder: Path,
    poses: TimedPoses | None,
    *,
    min_returns: int,
    media_type: str | None = None,
) -> FileDrive:
    """Open a drive of `*.bin` files that are named by nanoseconds since 1970.

    Raises:
        EmptyDrive: If there is none.
        MalformedDrive: If a name is no time, or no pose is near a scan.
    """
    files = in_order(folder.glob("[!.]*.bin"))
    if not files:
        raise EmptyDrive(f"{folder} has no scan files *.bin")
    odd = next((file for file in files if not file.stem.isdecimal()), None)
    if odd is not None:
        raise MalformedDrive(
            f"{odd} is not named by its time, wanted nanoseconds as 1561000444390857630.bin"
        )
    time_s = np.array([int(file.stem) / 1e9 for file in files])
    rows = np.full((len(files), 7), np.nan) if poses is None else poses.at(time_s)
    return FileDrive(name, files, time_s, rows, min_returns, media_type)
