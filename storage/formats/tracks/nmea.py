"""Logs of NMEA 0183 sentences: positions of GGA, or else RMC, with the dates of RMC."""

import math
import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from functools import reduce
from operator import xor
from pathlib import Path

from core.numbers import numbers_of
from storage.formats.drives.text_rows import lines_of
from storage.formats.errors import MalformedDrive, short

_DAY_S = 86_400.0
_CENTURY = 80  # from this year on, of two digits, it is 19.., as GPS began in 1980
_SENTENCE = re.compile(r"\$[A-Z]{2}(GGA|RMC),")
_FIELDS = {"GGA": 12, "RMC": 9}
_FIX = {"GGA": (0, 1, 3), "RMC": (0, 2, 4, 8)}  # time, latitude, longitude, and date
_TIME = re.compile(r"(\d\d)(\d\d)(\d\d(?:\.\d*)?)", re.ASCII)
_DATE = re.compile(r"\d{6}", re.ASCII)
_ANGLE = re.compile(r"(\d{1,3})(\d\d(?:\.\d*)?)", re.ASCII)


def is_nmea(text: str) -> bool:
    """Return whether a text has a sentence with a position."""
    return _SENTENCE.search(text) is not None


def read_nmea(file: Path) -> tuple[list[dict[str, float]], Sequence[str]]:
    """Return the fixes of a log, and a note if damaged sentences were left out.

    A sentence whose checksum is wrong or missing is damaged. Other sentences, other text, and
    sentences without a position, a time or, of RMC, a date are passed over: a receiver that has
    just started leaves them empty.

    Returns:
        `time_s` since 1970, `latitude_deg`, `longitude_deg` and, where the log has the height of
        the geoid, `altitude_m` above the ellipsoid; and the notes.

    Raises:
        MalformedDrive: If there is no position or no date, if a sentence has impossible values,
            or if most are damaged.
    """
    log = _Log(file.name)
    for number, line in enumerate(lines_of(file), 1):
        found = _SENTENCE.search(line)
        if found:
            log.take(number, found[1], line[found.start() + 1 :])
    fixes = list(log.fixes())
    if not log.damaged:
        return fixes, ()
    were = "sentence was" if len(log.damaged) == 1 else "sentences were"
    note = f"{file.name}: {len(log.damaged)} damaged {were} left out; the first: {log.damaged[0]}"
    return fixes, [note]


class _Log:
    """The positions of a log, in its order, and the dates between them."""

    def __init__(self, name: str) -> None:
        self.damaged: list[str] = []
        self._name = name
        self._dates_s: list[tuple[int, float]] = []  # how many GGA came before, and the time
        self._gga: list[tuple[float, dict[str, float]]] = []  # seconds of the day
        self._rmc: list[dict[str, float]] = []

    def take(self, number: int, kind: str, sentence: str) -> None:
        """Read a sentence, given without its `$`."""
        body, star, rest = sentence.partition("*")
        is_whole = star and re.fullmatch(r"[0-9A-Fa-f]{2}\s*", rest)
        wanted = f"{reduce(xor, body.encode('utf-8', 'replace'), 0):02X}"
        if not is_whole or rest.strip().upper() != wanted:
            got = (
                f"the checksum is {rest[:2]}, wanted {wanted}" if is_whole else "it has no checksum"
            )
            self.damaged.append(f"line {number}: {got}")
            return
        _, *fields = body.split(",")
        if len(fields) < _FIELDS[kind]:
            raise self._error(number, f"{kind} has {len(fields)} fields, wanted {_FIELDS[kind]}")
        if not all(fields[at] for at in _FIX[kind]):
            return
        if kind == "GGA":
            if fields[5] not in {"", "0"}:
                self._take_gga(number, fields)
        elif fields[1] == "A":
            self._take_rmc(number, fields)

    def _take_gga(self, number: int, fields: Sequence[str]) -> None:
        fix = self._place(number, fields[1:5])
        altitude, geoid = fields[8], fields[10]
        if altitude and geoid:
            try:
                fix["altitude_m"] = sum(numbers_of([altitude, geoid]))
            except ValueError:
                fix["altitude_m"] = math.nan
            if not math.isfinite(fix["altitude_m"]):
                texts = f"{short(altitude)} and {short(geoid)}"
                raise self._error(number, f"the altitude is {texts}, wanted two numbers of metres")
        self._gga.append((self._day_s(number, fields[0]), fix))

    def _take_rmc(self, number: int, fields: Sequence[str]) -> None:
        day_s = self._day_s(number, fields[0])
        date = fields[8]
        try:
            if _DATE.fullmatch(date) is None:
                raise ValueError(date)
            year = int(date[4:])
            year += 1900 if year >= _CENTURY else 2000
            day = datetime(year, int(date[2:4]), int(date[:2]), tzinfo=UTC)
        except ValueError:
            raise self._error(number, f"the date is {short(date)}, wanted ddmmyy") from None
        time_s = day.timestamp() + day_s
        self._dates_s.append((len(self._gga), time_s))
        self._rmc.append({"time_s": time_s, **self._place(number, fields[2:6])})

    def fixes(self) -> Iterator[dict[str, float]]:
        """Yield the fixes of GGA with their dates, or else those of RMC."""
        if len(self.damaged) > len(self._gga) + len(self._rmc):
            raise MalformedDrive(
                f"{self._name}: {len(self.damaged)} sentences are damaged, more than are not; the"
                f" first: {self.damaged[0]}"
            )
        if not self._gga and not self._rmc:
            raise MalformedDrive(
                f"{self._name} has no position: no GGA sentence with one, and no RMC sentence with"
                " one and a date"
            )
        if not self._gga:
            yield from self._rmc
            return
        if not self._dates_s:
            raise MalformedDrive(
                f"{self._name} has no RMC sentence with a date, and GGA has times of day only"
            )
        dates = iter([*self._dates_s[1:], (len(self._gga) + 1, 0.0)])
        _, near_s = self._dates_s[0]
        until, next_s = next(dates)
        for at, (day_s, fix) in enumerate(self._gga):
            while until <= at:
                near_s = next_s
                until, next_s = next(dates)
            # The day on which this time of day is less than half a day from the date's.
            days = round((near_s - day_s) / _DAY_S)
            yield {"time_s": days * _DAY_S + day_s, **fix}

    def _day_s(self, number: int, text: str) -> float:
        found = _TIME.fullmatch(text)
        if found is None or int(found[1]) > 23 or int(found[2]) > 59 or float(found[3]) >= 61:
            raise self._error(number, f"the time is {short(text)}, wanted hhmmss")
        return 3600.0 * int(found[1]) + 60.0 * int(found[2]) + float(found[3])

    def _place(self, number: int, fields: Sequence[str]) -> dict[str, float]:
        return {
            "latitude_deg": self._angle(number, "latitude", *fields[:2], signs="NS", most=90.0),
            "longitude_deg": self._angle(number, "longitude", *fields[2:], signs="EW", most=180.0),
        }

    def _angle(
        self, number: int, name: str, text: str, side: str, *, signs: str, most: float
    ) -> float:
        found = _ANGLE.fullmatch(text)
        angle_deg = most + 1.0 if found is None else int(found[1]) + float(found[2]) / 60.0
        if angle_deg > most or (found and float(found[2]) >= 60.0) or side not in set(signs):
            raise self._error(
                number,
                f"the {name} is {short(text)} {short(side)}, wanted degrees and minutes, as"
                f" 4900.6000, and {' or '.join(signs)}",
            )
        return -angle_deg if side == signs[1] else angle_deg

    def _error(self, number: int, reason: str) -> MalformedDrive:
        return MalformedDrive(f"{self._name}, line {number}: {reason}")
