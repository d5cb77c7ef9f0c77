"""GPX files (topografix.com/GPX/1/1): the points of their tracks, with times.

Expat reads them, and a document type is refused: without one there are no entities to expand and
nothing outside of the file to fetch.
"""

import math
from datetime import UTC, datetime
from pathlib import Path
from xml.parsers import expat

from core.numbers import numbers_of
from storage.formats.errors import MalformedDrive, short

_BOUNDS = {"lat": 90.0, "lon": 180.0, "ele": 1e5, "geoidheight": 1e3}


def read_gpx(file: Path) -> list[dict[str, float]]:
    """Return the fixes of all tracks of a file, in its order.

    A GPX elevation is above the sea. With `<geoidheight>` the altitude above the ellipsoid is their
    sum; without it the altitude is unknown.

    Returns:
        `time_s` since 1970, `latitude_deg`, `longitude_deg` and, if known, `altitude_m`.

    Raises:
        MalformedDrive: If it is no such file, or a point has no place or time.
    """
    reader = _Reader(file.name)
    try:
        with file.open("rb") as opened:
            reader.parser.ParseFile(opened)
    except expat.ExpatError as error:
        raise MalformedDrive(
            f"{file.name}, line {error.lineno}: {expat.ErrorString(error.code)}"
        ) from error
    except (LookupError, ValueError) as error:  # of Python, which has Expat read other encodings
        line = reader.parser.CurrentLineNumber
        raise MalformedDrive(
            f"{file.name}, line {line}: its encoding cannot be read, {error}; wanted UTF-8"
        ) from error
    if not reader.fixes:
        raise MalformedDrive(f"{file.name} has no point of a track with a time (<trkpt>)")
    return reader.fixes


class _Reader:
    """Collects the points while a parser reads."""

    def __init__(self, name: str) -> None:
        self.fixes: list[dict[str, float]] = []
        self._name = name
        self._path: list[str] = []
        self._line = 0
        self._of_point: dict[str, str] = {}
        self.parser = expat.ParserCreate(namespace_separator=" ")
        self.parser.buffer_text = True
        self.parser.StartDoctypeDeclHandler = self._refuse_type
        self.parser.StartElementHandler = self._begin
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._text

    def _refuse_type(self, *_: object) -> None:
        raise self._error("it declares a document type, which a GPX file does not have")

    def _begin(self, name: str, attributes: dict[str, str]) -> None:
        name = name.rpartition(" ")[2]  # without the namespace
        if not self._path and name != "gpx":
            self._line = self.parser.CurrentLineNumber
            raise self._error(f"it begins with <{name[:40]}>, wanted <gpx>")
        self._path.append(name)
        if name == "trkpt":
            self._line = self.parser.CurrentLineNumber
            self._of_point = dict(attributes)

    def _text(self, text: str) -> None:
        if self._path[-2:-1] == ["trkpt"]:
            self._of_point[self._path[-1]] = self._of_point.get(self._path[-1], "") + text

    def _end(self, _name: str) -> None:
        if self._path.pop() == "trkpt":
            self.fixes.append(self._fix())

    def _fix(self) -> dict[str, float]:
        fix = {
            "time_s": self._time_s(),
            "latitude_deg": self._number("lat"),
            "longitude_deg": self._number("lon"),
        }
        if {"ele", "geoidheight"} <= self._of_point.keys():
            fix["altitude_m"] = self._number("ele") + self._number("geoidheight")
        return fix

    def _number(self, name: str) -> float:
        text = self._of_point.get(name)
        if text is None:
            raise self._error(f"the point has no {name}")
        try:
            [value] = numbers_of([text])
        except ValueError:
            value = math.nan
        if not abs(value) <= _BOUNDS[name]:
            raise self._error(f"{name} is {short(text)}, wanted at most {_BOUNDS[name]:g}")
        return value

    def _time_s(self) -> float:
        text = self._of_point.get("time")
        if text is None:
            raise self._error("the point has no <time>: fixes without one cannot be used")
        try:
            time = datetime.fromisoformat(text.strip())
            # The format's times are UTC, also where a program wrote no zone.
            return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()
        except (ValueError, OverflowError):
            raise self._error(
                f"the time is {short(text)}, wanted one as 2026-11-23T12:00:00Z"
            ) from None

    def _error(self, reason: str) -> MalformedDrive:
        line = self._line or self.parser.CurrentLineNumber
        return MalformedDrive(f"{self._name}, line {line}: {reason}")
