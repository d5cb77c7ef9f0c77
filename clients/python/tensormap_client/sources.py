"""Recorded drives to upload: files in order, sent unchanged."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

from tensormap_client.errors import InvalidArgument

_KITTI_SCANS = "velodyne"
_CALIBRATION = "calib.txt"
_KITTI_FILES = ("times.txt", "poses.txt", _CALIBRATION)
_SUFFIXES = frozenset({".bin", ".npy", ".pcd", ".ply", ".csv", ".las", ".laz", ".mat"})
_MEDIA_TYPE = "application/vnd.tensormap."
# Of other suffixes it is their name.
_FORMATS = {"bin": "kitti", "pcd.bin": "nuscenes", "laz": "las", "mat": "ford"}
_NUSCENES = ".pcd.bin"
_NUMBER = re.compile(r"\d+", re.ASCII)
_TIME = re.compile(r"\d{1,10}\.\d{1,9}", re.ASCII)
_FRACTION = re.compile(r"(?<!\d)\d{1,10}\.(\d{1,9})$", re.ASCII)
_GAP = 2.6  # usual steps of numbers: a shorter gap is none for the service's odometry either
_SECONDS = re.compile(r"(?<!\d)([1-9]\d{9}\.)(\d{1,9})(?!\d)", re.ASCII)
_NANOSECOND_DIGITS = 9
_SINCE_1970 = re.compile(r"[1-9]\d*", re.ASCII)
_TICKS_PER_S = {10: 1, 13: 10**3, 16: 10**6, 19: 10**9}  # by the number of digits
_CALENDAR = re.compile(r"(\d{4})" + r"(\d\d)" * 5 + r"(\d\d|\d{3}|\d{6})?", re.ASCII)
_YEARS = range(1990, 2101)
_LATEST_S = 2**32  # in 2106: larger whole numbers are no times


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

    `times.txt`, `poses.txt` and `calib.txt` in it are read as KITTI's, by the service.

    Files are ordered by the times that their names give, seconds with a fraction or whole
    seconds, milli-, micro- or nanoseconds since 1970 or a date and time of UTC as 20230316205320,
    or else of the numbers in their names.

    Args:
        path: The folder.
        format_name: The files' format, if not that of their suffix; `.bin` is `kitti`, `.pcd.bin`
            is `nuscenes`.

    Raises:
        InvalidArgument: If the folder has no scan file, some names are times and others are not,
            two are the same time, fractions in names may be no decimals, two names differ in their
            suffixes only, or a number is missing between the scans to which KITTI's times or poses
            belong.
    """

    def __init__(self, path: Path | str, format_name: str | None = None) -> None:
        path = Path(path)
        self.name = path.resolve().name
        self.beside = tuple(path / name for name in _KITTI_FILES if (path / name).is_file())
        scans = path / _KITTI_SCANS if (path / _KITTI_SCANS).is_dir() else path
        if not scans.is_dir():
            raise InvalidArgument(f"{path} is no folder of scans")
        named = _in_order(scans, _scan_files(scans))
        # Names only: of 100,000 files that is some megabytes.
        self._folder, self._names = scans, [file.name for _, file in named]
        self._times_s = [time_s for time_s, _ in named]
        with_lines = [file.name for file in self.beside if file.name != _CALIBRATION]
        if with_lines and self._times_s[0] is None:
            _require_no_gap(with_lines, self._names)
        self._format_name = format_name

    def __len__(self) -> int:
        return len(self._names)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on what the upload loses: numbers of missing files, if the scans have no times."""
        has_times = any(file.name != _CALIBRATION for file in self.beside)
        return () if has_times else lost_numbers(self._names)

    def scan_body(self, index: int) -> ScanBody:
        """Return a scan to upload."""
        file = self._folder / self._names[index]
        suffix = _suffix(file).removeprefix(".")
        kind = self._format_name or _FORMATS.get(suffix, suffix)
        return ScanBody(index, file.read_bytes(), _MEDIA_TYPE + kind, self._times_s[index])


def lost_numbers(names: Sequence[str]) -> tuple[str, ...]:
    """Return a note if numbers of scans are missing among names, as scans are numbered from 0.

    Names count scans if they rise, most by one and the same step.

    Args:
        names: Names of scan files without times, in order.
    """
    files = [Path(name) for name in names]
    stems = [_stem(file) for file in files]
    if not all(map(_NUMBER.fullmatch, stems)) or any(_time_s(file) is not None for file in files):
        return ()
    numbers = [int(stem) for stem in stems]
    steps = [later - earlier for earlier, later in pairwise(numbers)]
    usual, times = Counter(steps).most_common(1)[0] if steps else (1, 0)
    if min(steps, default=0) <= 0 or 2 * times <= len(steps):
        return ()
    gaps = [at for at, step in enumerate(steps) if step > _GAP * usual]
    if not gaps:
        return ()
    at, others = gaps[0], len(gaps) - 1
    more = f" and {others} more range{'s' * (others > 1)}" if others else ""
    lost = f"{numbers[at] + usual} to {numbers[at + 1] - usual}"
    return (
        f"scan files {lost}{more} are missing, and scans are numbered from 0 without a gap:"
        f" odometry takes {names[at]} and {names[at + 1]} for neighbours, and its poses behind them"
        " are wrong. Send the files as a tar, which keeps their numbers, or number them from 0"
        " without a gap, beside a times.txt",
    )


def _scan_files(folder: Path) -> list[Path]:
    """Return the scan files in a folder, in any order."""
    files = [
        file
        for file in folder.iterdir()
        if file.suffix.lower() in _SUFFIXES and not file.name.startswith(".") and not file.is_dir()
    ]
    if not files:
        raise InvalidArgument(f"{folder} has no scan file ({' '.join(sorted(_SUFFIXES))})")
    _require_each_once(folder, files)
    return files


def _in_order(folder: Path, files: Sequence[Path]) -> list[tuple[float | None, Path]]:
    """Return scan files in order, each after the time that is its name, `None` if it is none."""
    times_s = [_time_s(file) for file in files]
    if len({time_s is None for time_s in times_s}) > 1:
        raise InvalidArgument(f"{folder} has files that are named by a time, and others")
    odd = _no_decimals(files)
    if odd and times_s[0] is not None:
        raise InvalidArgument(
            f"{' and '.join(odd)} may be named by nanoseconds without leading zeros, wanted"
            f" {_NANOSECOND_DIGITS} digits after each point"
        )
    named = sorted(
        zip(times_s, files, strict=True),
        key=lambda one: (one[0] or 0.0, _numbers(one[1], are_decimals=not odd)),
    )
    for (time_s, earlier), (later_s, later) in pairwise(named):
        if time_s is not None and time_s == later_s:
            raise InvalidArgument(f"{earlier.name} and {later.name} are the same time")
    return named


def _suffix(file: Path) -> str:
    return _NUSCENES if file.name.lower().endswith(_NUSCENES) else file.suffix.lower()


def _stem(file: Path) -> str:
    return file.name[: -len(_suffix(file))]


def _time_s(file: Path) -> float | None:
    """Return the seconds that a file's name is, `None` if it is no time."""
    stem = _stem(file)
    if _TIME.fullmatch(stem):
        return float(stem)
    calendar_s = _calendar_s(stem)
    if calendar_s is not None:
        return calendar_s
    if len(stem) not in _TICKS_PER_S or not _SINCE_1970.fullmatch(stem):
        return None
    time_s = int(stem) / _TICKS_PER_S[len(stem)]
    return time_s if time_s < _LATEST_S else None


def _calendar_s(stem: str) -> float | None:
    """Return the seconds since 1970 of `YYYYMMDDhhmmss`, with a fraction or without, UTC."""
    found = _CALENDAR.fullmatch(stem)
    if found is None or int(found[1]) not in _YEARS:
        return None
    year, month, day, hour, minute, second = map(int, found.groups()[:6])
    try:
        whole_s = datetime(year, month, day, hour, minute, second, tzinfo=UTC).timestamp()
    except ValueError:  # no such day or time of day
        return None
    return whole_s + float(f"0.{found[7] or 0}")


def _no_decimals(files: Sequence[Path]) -> tuple[str, ...]:
    """Return two names that may have nanoseconds without leading zeros, as ROS 2's tools write."""
    found = {file.name: _FRACTION.search(_stem(file)) for file in files}
    digits = {name: one[1] for name, one in found.items() if one}
    if any(len(one) > 1 and one.startswith("0") for one in digits.values()):
        return ()
    short = min(digits, key=lambda name: len(digits[name]), default="")
    long = max(digits, key=lambda name: len(digits[name]), default="")
    if short and len(digits[short]) < len(digits[long]) == _NANOSECOND_DIGITS:
        return short, long
    return ()


def _require_each_once(folder: Path, files: Sequence[Path]) -> None:
    """Reject a scan in two formats, which would be two of the drive."""
    by_stem: dict[str, Path] = {}
    for file in sorted(files):
        earlier = by_stem.setdefault(_stem(file), file)
        if earlier is not file:
            raise InvalidArgument(f"{folder} has a scan twice, as {earlier.name} and {file.name}")


def _require_no_gap(with_lines: Sequence[str], names: Sequence[str]) -> None:
    """Reject scans with a number missing between them: which line is whose is not known."""
    stems = [_stem(Path(name)) for name in names]
    if not all(map(_NUMBER.fullmatch, stems)):
        return
    for at, (earlier, later) in enumerate(pairwise(stems)):
        if int(later) > int(earlier) + 1:
            raise InvalidArgument(
                f"{names[at]} is followed by {names[at + 1]} and there are lines for each scan in"
                f" {' and '.join(with_lines)}: wanted scans of consecutive"
                " numbers, or no such file"
            )


def _numbers(file: Path, *, are_decimals: bool) -> tuple[list[tuple[str, int]], str]:
    name = file.name
    if are_decimals:
        name = _SECONDS.sub(lambda found: found[1] + found[2].ljust(_NANOSECOND_DIGITS, "0"), name)
    parts = re.findall(r"([^0-9]*)([0-9]*)", name)
    return [(text, int(digits or -1)) for text, digits in parts], file.name
