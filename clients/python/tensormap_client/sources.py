"""Recorded drives to upload: files in order, sent unchanged."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

from tensormap_client.errors import InvalidArgument

_KITTI_SCANS = "velodyne"
_KITTI_FILES = ("times.txt", "poses.txt", "calib.txt")
_SUFFIXES = frozenset({".bin", ".npy", ".pcd", ".ply", ".csv", ".las", ".laz", ".mat"})
_MEDIA_TYPE = "application/vnd.tensormap."
_FORMATS = {"bin": "kitti", "laz": "las", "mat": "ford"}  # of other suffixes it is their name
_TIME = re.compile(r"\d{1,10}\.\d{1,9}", re.ASCII)
_SINCE_1970 = re.compile(r"[1-9]\d*", re.ASCII)
_TICKS_PER_S = {10: 1, 13: 10**3, 16: 10**6, 19: 10**9}  # by the number of digits


@dataclass(frozen=True, eq=False)
class ScanBody:
    """One scan to upload.

    Attributes:
        index: The scan's index in the drive.
        body: The file's bytes, which the service parses.
        media_type: The body's media type.
        timestamp_s: The scan's time, `None` if unknown.
        pose: The pose, sensor to world, as x, y, z, qx, qy, qz, qw; `None` if unknown.
        returns_m: Returns `(n, 3)` float32 returns as the service reads them, if the source can:
            stored scans are then compared with it, not sent again.
    """

    index: int
    body: bytes
    media_type: str
    timestamp_s: float | None = None
    pose: tuple[float, ...] | None = None
    returns_m: Callable[[], NDArray[Any]] | None = None


class Source(Protocol):
    """A drive to upload; scans are numbered from 0 in order."""

    @property
    def name(self) -> str:
        """A short name."""

    @property
    def beside(self) -> tuple[Path, ...]:
        """Files with times, poses and calibration in KITTI's format, which the service reads."""

    def __len__(self) -> int:
        """Return the number of scans."""

    def scan_body(self, index: int) -> ScanBody:
        """Return a scan to upload; sequential access is the fastest.

        Raises:
            UnusableScan: If the scan cannot be used.
            OSError: If the scan's file cannot be read.
        """


class FolderSource:
    """A folder of scan files, or one in KITTI's layout; satisfies `Source`.

    Files are ordered by the times that their names give, seconds with a fraction or whole
    seconds, milli-, micro- or nanoseconds since 1970, or else of the numbers in their names.

    Args:
        path: The folder.
        format_name: The files' format, if not that of their suffix; `.bin` is `kitti`.

    Raises:
        InvalidArgument: If the folder has no scan file, or some names are times and others are not.
    """

    def __init__(self, path: Path, format_name: str | None = None) -> None:
        self.name = path.resolve().name
        self.beside: tuple[Path, ...] = ()
        scans = path
        if (path / _KITTI_SCANS).is_dir():
            scans = path / _KITTI_SCANS
            self.beside = tuple(path / name for name in _KITTI_FILES if (path / name).is_file())
        if not scans.is_dir():
            raise InvalidArgument(f"{path} is no folder of scans")
        files = [file for file in scans.iterdir() if file.suffix.lower() in _SUFFIXES]
        if not files:
            raise InvalidArgument(f"{scans} has no scan file ({' '.join(sorted(_SUFFIXES))})")
        times_s = [_time_s(file) for file in files]
        if len({time_s is None for time_s in times_s}) > 1:
            raise InvalidArgument(f"{scans} has files that are named by a time, and others")
        named = sorted(
            zip(times_s, files, strict=True), key=lambda one: (one[0] or 0.0, _numbers(one[1]))
        )
        # Names only: of 100,000 files that is some megabytes.
        self._folder, self._names = scans, [file.name for _, file in named]
        self._times_s = [time_s for time_s, _ in named]
        self._format_name = format_name

    def __len__(self) -> int:
        return len(self._names)

    def scan_body(self, index: int) -> ScanBody:
        """Return a scan to upload."""
        file = self._folder / self._names[index]
        suffix = file.suffix.lower().removeprefix(".")
        kind = self._format_name or _FORMATS.get(suffix, suffix)
        return ScanBody(index, file.read_bytes(), _MEDIA_TYPE + kind, self._times_s[index])


def _time_s(file: Path) -> float | None:
    """Return the seconds that a file's name is, `None` if it is no time."""
    if _TIME.fullmatch(file.stem):
        return float(file.stem)
    if len(file.stem) not in _TICKS_PER_S or not _SINCE_1970.fullmatch(file.stem):
        return None
    return int(file.stem) / _TICKS_PER_S[len(file.stem)]


def _numbers(file: Path) -> tuple[list[tuple[str, int]], str]:
    parts = re.findall(r"([^0-9]*)([0-9]*)", file.name)
    return [(text, int(digits or -1)) for text, digits in parts], file.name
