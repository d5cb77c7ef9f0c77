"""A drive whose scans are files, read on demand."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from core.arrays import FloatArray, IntArray, frozen
from core.errors import EmptyDrive, InvalidPose
from core.scans.pose import Pose, first_invalid, is_known
from core.scans.scan import Scan
from core.scans.times import first_flawed, flaw_of_time
from core.text import count_of
from storage.formats.errors import MalformedDrive
from storage.formats.scans.file_names import Fractions, numbers_of, time_s_of
from storage.formats.scans.registry import read_scan_file

_SECONDS = re.compile(r"(?<!\d)([1-9]\d{9}\.)(\d{1,9})(?!\d)", re.ASCII)
"""Seconds since 1970 with a fraction, anywhere in a name."""


@dataclass(frozen=True, eq=False)
class FileDrive:
    """One scan in each file; timestamps and poses are known beforehand. A `NamedDrive`.

    Times may fall from a scan to the next: the folder is the user's, and a build of it notes them.
    A service refuses such times in an upload or with `PUT`, before they are stored.

    Attributes:
        name: A short name.
        files: The scan files in order.
        timestamp_s: `(K,)` seconds, NaN where unknown.
        poses: `(K, 7)` pose rows, sensor to world, NaN where unknown.
        min_returns: Least number of returns of a scan.
        media_type: Format of the files, if not that of their suffix.
    """

    name: str
    files: tuple[Path, ...]
    timestamp_s: FloatArray
    poses: FloatArray
    min_returns: int = 1
    media_type: str | None = None

    def __post_init__(self) -> None:
        count = len(self.files)
        if not count:
            raise EmptyDrive(f"drive {self.name!r} has no scan files")
        if self.timestamp_s.shape != (count,) or self.poses.shape != (count, 7):
            raise MalformedDrive(
                f"drive {self.name!r} has {count_of(count, 'scan')}, timestamps of shape"
                f" {self.timestamp_s.shape} and poses of shape {self.poses.shape}"
            )
        wrong = first_flawed(self.timestamp_s)
        if wrong is not None:
            flaw = flaw_of_time(self.timestamp_s[wrong])
            raise MalformedDrive(f"the time of scan {wrong} of drive {self.name!r} is {flaw}")
        wrong = first_invalid(self.poses)
        if wrong is not None:
            try:
                Pose(*self.poses[wrong].tolist())
            except InvalidPose as error:  # which names what is wrong
                raise MalformedDrive(
                    f"the pose of scan {wrong} of drive {self.name!r}: {error}"
                ) from error
        known_s = np.where(np.isfinite(self.timestamp_s), self.timestamp_s, np.nan)
        object.__setattr__(self, "timestamp_s", frozen(known_s, np.float64))
        object.__setattr__(self, "poses", frozen(self.poses, np.float64))

    @cached_property
    def named_index(self) -> IntArray | None:
        """`(K,)` the numbers that are the files' names, `None` if they are no scans' numbers."""
        return numbers_of(file.name for file in self.files)

    def __len__(self) -> int:
        return len(self.files)

    def __repr__(self) -> str:  # without the names of thousands of files
        posed = int(is_known(self.poses).sum())
        return f"FileDrive(name={self.name!r}, scans={len(self)}, {posed=})"

    def scan(self, index: int) -> Scan:
        """Read scan `index`, 0-based.

        Raises:
            InvalidScan: If the file cannot be used; a subclass says why.
        """
        return read_scan_file(
            self.files[index],
            min_returns=self.min_returns,
            media_type=self.media_type,
            timestamp_s=float(self.timestamp_s[index]),
            pose=Pose.from_row(self.poses[index]),
        )


def in_time_order(files: Iterable[Path]) -> tuple[tuple[Path, ...], FloatArray]:
    """Sort files by the times that are their names, or else as `in_order`.

    Returns:
        The files, and their times, `(n,)` seconds, NaN if the names are none.

    Raises:
        MalformedDrive: If some names are times and others are not, two are the same time, or their
            fractions may be no decimals.

    Examples:
        >>> files, timestamp_s = in_time_order([Path("1.5.npy"), Path("1.45.npy")])
        >>> [file.name for file in files], timestamp_s.tolist()
        (['1.45.npy', '1.5.npy'], [1.45, 1.5])
    """
    files = in_order(files)
    times = [time_s_of(file.name) for file in files]
    known = [time_s is not None for time_s in times]
    if not any(known):
        return files, np.full(len(files), np.nan)
    if not all(known):
        raise MalformedDrive(
            f"{files[known.index(True)].name} is named by a time,"
            f" {files[known.index(False)].name} is not: wanted one or the other"
        )
    flaw = _fractions_of(files).flaw
    if flaw is not None:
        raise MalformedDrive(flaw)
    timestamp_s = np.array(times, dtype=np.float64)
    order = np.argsort(timestamp_s, kind="stable")
    files, timestamp_s = tuple(files[at] for at in order), timestamp_s[order]
    same = np.flatnonzero(np.diff(timestamp_s) == 0.0)
    if len(same):
        raise MalformedDrive(
            f"{files[same[0]].name} and {files[same[0] + 1].name} are the same time"
        )
    return files, timestamp_s


def in_order(files: Iterable[Path]) -> tuple[Path, ...]:
    """Sort files by name, the numbers in it by value, also those after seconds since 1970.

    Examples:
        >>> files = in_order([Path("at_1679000000.5.npy"), Path("at_1679000000.45.npy")])
        >>> [file.name for file in files]
        ['at_1679000000.45.npy', 'at_1679000000.5.npy']
        >>> [file.name for file in in_order([Path("10.npy"), Path("9.npy"), Path("a1.npy")])]
        ['9.npy', '10.npy', 'a1.npy']
    """
    files = list(files)
    are_decimals = _fractions_of(files).flaw is None
    return tuple(sorted(files, key=partial(_name_key, are_decimals=are_decimals)))


def _fractions_of(files: Iterable[Path]) -> Fractions:
    fractions = Fractions()
    for file in files:
        fractions.take(file.name)
    return fractions


def _name_key(file: Path, *, are_decimals: bool) -> tuple[list[tuple[str, int]], str]:
    name = file.name
    if are_decimals:
        name = _SECONDS.sub(lambda found: found[1] + found[2].ljust(9, "0"), name)
    parts = re.findall(r"([^0-9]*)([0-9]*)", name)
    return [(text, int(digits or -1)) for text, digits in parts], file.name
