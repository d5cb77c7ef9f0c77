"""The time or the number that is a scan file's name: many tools record folders of such files."""

import re
from collections.abc import Iterable
from datetime import UTC, datetime

import numpy as np

from core.arrays import IntArray
from storage.formats.scans.registry import suffix_of

_TIME = re.compile(r"\d{1,10}\.\d{1,9}", re.ASCII)
_FRACTION = re.compile(r"(?<!\d)\d{1,10}\.(\d{1,9})$", re.ASCII)
_SINCE_1970 = re.compile(r"[1-9]\d*", re.ASCII)
_TICKS_PER_S = {10: 1, 13: 10**3, 16: 10**6, 19: 10**9}
"""Ticks a second by the number of digits that any moment between 2001 and 2286 has."""
_CALENDAR = re.compile(r"(\d{4})" + r"(\d\d)" * 5 + r"(\d\d|\d{3}|\d{6})?", re.ASCII)
_YEARS = range(1990, 2101)  # 16 digits that are microseconds since 1970 begin as one from 2033 on
_NUMBER = re.compile(r"\d{1,18}", re.ASCII)  # more digits are above 64 bits
_NANOSECOND_DIGITS = 9
_LATEST_S = 2**32  # in 2106: larger numbers are none of our times


def time_s_of(name: str) -> float | None:
    """Return the seconds that a file's name is, `None` if it is no time.

    A time has a fraction, or is a whole number since 1970: of seconds with 10 digits, milliseconds
    with 13, microseconds with 16 or nanoseconds with 19. A date and time of UTC is one too,
    `YYYYMMDDhhmmss` with 2, 3 or 6 digits of a fraction or none. Other whole numbers are indices.

    Args:
        name: Without folders, with the suffix.

    Examples:
        >>> time_s_of("1679000000.100000.bin"), time_s_of("1679000000100000000.pcd")
        (1679000000.1, 1679000000.1)
        >>> time_s_of("1326652795280148.bin"), time_s_of("1679000000.npy")
        (1326652795.280148, 1679000000.0)
        >>> time_s_of("20230316205320.pcd"), time_s_of("2023031620532025.pcd")
        (1679000000.0, 1679000000.25)
        >>> time_s_of("000012.pcd.bin") is None
        True
    """
    stem = _stem(name)
    if _TIME.fullmatch(stem):
        return float(stem)
    calendar_s = _calendar_s(stem)
    if calendar_s is not None:
        return calendar_s
    ticks_per_s = _TICKS_PER_S.get(len(stem))
    if ticks_per_s is None or not _SINCE_1970.fullmatch(stem):
        return None
    time_s = int(stem) / ticks_per_s
    return time_s if time_s < _LATEST_S else None


def _calendar_s(stem: str) -> float | None:
    found = _CALENDAR.fullmatch(stem)
    if found is None or int(found[1]) not in _YEARS:
        return None
    year, month, day, hour, minute, second = map(int, found.groups()[:6])
    try:
        whole_s = datetime(year, month, day, hour, minute, second, tzinfo=UTC).timestamp()
    except ValueError:  # no such day or time of day
        return None
    return whole_s + float(f"0.{found[7] or 0}")


def numbers_of(names: Iterable[str]) -> IntArray | None:
    """Return the numbers that names of files in order are, `(n,)`; `None` if they count no scans.

    They do if they rise, most by one and the same step, as every scan or every tenth one does.
    Numbers that rise by chance are those of scans that somebody chose: where some are missing is
    not known.

    Examples:
        >>> numbers_of(["000019.bin", "000020.bin", "000021.bin", "000040.bin"]).tolist()
        [19, 20, 21, 40]
        >>> numbers_of(["10.pcd", "20.pcd", "30.pcd", "70.pcd"]).tolist()
        [10, 20, 30, 70]
        >>> numbers_of(["3.npy", "7.npy", "12.npy"]) is None
        True
        >>> numbers_of(["1679000000.bin", "1679000001.bin"]) is None  # times
        True
    """
    named = list(names)
    if not all(_NUMBER.fullmatch(_stem(name)) and time_s_of(name) is None for name in named):
        return None
    numbers = np.array([int(_stem(name)) for name in named], np.int64)
    steps = np.diff(numbers)
    _, times = np.unique(steps, return_counts=True)
    if (steps <= 0).any() or 2 * times.max(initial=0) <= len(steps):
        return None
    return numbers


class Fractions:
    """The fractions at the end of the names of one drive: whether these are decimals.

    ROS 2's `pointcloud_to_pcd` writes whole nanoseconds without leading zeros: 5 ms after a second
    is `.5000000`, half a second by its looks. Decimals without trailing zeros have as different
    lengths, but of many some begin with a zero.

    Examples:
        >>> names = Fractions()
        >>> names.take("9.5000000.pcd")
        >>> names.flaw is None
        True
        >>> names.take("9.105000000.pcd")
        >>> names.flaw
        '9.5000000.pcd and 9.105000000.pcd may be named by nanoseconds without leading zeros, ...
    """

    def __init__(self) -> None:
        self._short = self._long = ""
        self._are_decimals = False

    def take(self, name: str) -> None:
        """Take a name into account; those without a fraction say nothing."""
        found = _FRACTION.search(_stem(name))
        if found is None:
            return
        digits = found[1]
        self._are_decimals |= len(digits) > 1 and digits.startswith("0")
        if len(digits) == _NANOSECOND_DIGITS:
            self._long = self._long or name
        else:
            self._short = self._short or name

    @property
    def flaw(self) -> str | None:
        """What is wrong with the names, `None` if nothing is."""
        if self._are_decimals or not (self._short and self._long):
            return None
        return (
            f"{self._short} and {self._long} may be named by nanoseconds without leading zeros,"
            f" wanted {_NANOSECOND_DIGITS} digits after each point"
        )


def _stem(name: str) -> str:
    return name[: len(name) - len(suffix_of(name))]
