"""The time that is a scan file's name: a recording of many tools is a folder of such files."""

import re

from storage.formats.scans.registry import suffix_of

_TIME = re.compile(r"\d{1,10}\.\d{1,9}", re.ASCII)
_FRACTION = re.compile(r"(?<!\d)\d{1,10}\.(\d{1,9})$", re.ASCII)
_SINCE_1970 = re.compile(r"[1-9]\d*", re.ASCII)
_TICKS_PER_S = {10: 1, 13: 10**3, 16: 10**6, 19: 10**9}
"""Ticks a second by the number of digits that any moment between 2001 and 2286 has."""
_NANOSECOND_DIGITS = 9
_LATEST_S = 2**32  # in 2106: larger numbers are none of our times


def time_s_of(name: str) -> float | None:
    """Return the seconds that a file's name is, `None` if it is no time.

    A time has a fraction, or is a whole number since 1970: of seconds with 10 digits, milliseconds
    with 13, microseconds with 16 or nanoseconds with 19. Other whole numbers are indices.

    Args:
        name: Without folders, with the suffix.

    Examples:
        >>> time_s_of("1679000000.100000.bin"), time_s_of("1679000000100000000.pcd")
        (1679000000.1, 1679000000.1)
        >>> time_s_of("1326652795280148.bin"), time_s_of("1679000000.npy")
        (1326652795.280148, 1679000000.0)
        >>> time_s_of("000012.pcd.bin") is None
        True
    """
    stem = _stem(name)
    if _TIME.fullmatch(stem):
        return float(stem)
    ticks_per_s = _TICKS_PER_S.get(len(stem))
    if ticks_per_s is None or not _SINCE_1970.fullmatch(stem):
        return None
    time_s = int(stem) / ticks_per_s
    return time_s if time_s < _LATEST_S else None


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
