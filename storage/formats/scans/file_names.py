"""The time that is a scan file's name: a recording of many tools is a folder of such files."""

import re

from storage.formats.scans.registry import suffix_of

_TIME = re.compile(r"\d{1,10}\.\d{1,9}", re.ASCII)
_NANOSECONDS = re.compile(r"[1-9]\d{18}", re.ASCII)


def time_s_of(name: str) -> float | None:
    """Return the seconds that a file's name is, `None` if it is no time.

    A time has a fraction, or is in nanoseconds since 1970: 19 digits. Whole numbers of fewer digits
    are indices.

    Args:
        name: Without folders, with the suffix.

    Examples:
        >>> time_s_of("1679000000.100000.bin"), time_s_of("1679000000100000000.pcd")
        (1679000000.1, 1679000000.1)
        >>> time_s_of("000012.pcd.bin") is None
        True
    """
    stem = name[: len(name) - len(suffix_of(name))]
    if _TIME.fullmatch(stem):
        return float(stem)
    return int(stem) / 10**9 if _NANOSECONDS.fullmatch(stem) else None
