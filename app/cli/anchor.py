"""`tensormap anchor`: a map's place on the Earth, from the track of a GNSS receiver."""

import csv
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from tensormap_client import Admin, ClientError

from app.cli.console import say
from app.cli.errors import CommandFailed
from app.cli.service_options import KeyFile, ServiceUrl, read_key
from app.maps.anchor_schemas import MOST_FIXES
from storage.formats.tracks.gpx import read_gpx
from storage.formats.tracks.nmea import is_nmea, read_nmea

_NEEDED = ("time_s", "latitude_deg", "longitude_deg")
_TABLES = {".csv", ".json"}
_KNOWN = (*_NEEDED, "altitude_m", "accuracy_m")
_WANTED = (
    f"wanted GPX, NMEA (GGA, RMC), or the columns {', '.join(_NEEDED)} and, if known, altitude_m"
    " and accuracy_m"
)


def anchor(
    track: Annotated[
        Path,
        typer.Argument(
            metavar="TRACK",
            help="A .gpx; a log of NMEA sentences (GGA, RMC); a .csv with the columns time_s,"
            " latitude_deg, longitude_deg and, if known, altitude_m and accuracy_m; or a .json, a"
            " list of such objects.",
        ),
    ],
    url: ServiceUrl,
    map_slug: Annotated[str, typer.Option("--map", help="The drive's map.")],
    drive_slug: Annotated[
        str, typer.Option("--drive", help="The drive of the live revision with the receiver.")
    ],
    key_file: KeyFile = None,
) -> None:
    """Fit a map's anchor on the Earth to the GNSS track of one of its drives, and set it."""
    fixes = read_fixes(track)
    fixes = fixes[:: -(-len(fixes) // MOST_FIXES)]
    key = read_key(key_file)
    try:
        with Admin(url, key) as admin:
            found = admin.fit_anchor(map_slug, drive_slug, fixes)["anchor"]
    except ClientError as error:
        raise CommandFailed(str(error)) from error
    fit = found["fitted"]
    say(
        f"{map_slug}: ({found['x_m']:.1f}, {found['y_m']:.1f}) m is at {found['latitude_deg']:.7f},"
        f" {found['longitude_deg']:.7f}, x points {found['heading_deg']:z.2f} deg north of east;"
        f" {fit['agreeing']} of {fit['fixes']} fixes agree within {fit['spread_m']:.2f} m, known"
        f" to {fit['error_m']:.2f} m and {fit['error_deg']:.2f} deg (standard deviations)"
    )
    if fit.get("altitudes") == 0:
        say("no fix that agrees has an altitude above the ellipsoid: that of the map is unknown")


def read_fixes(track: Path) -> Sequence[Mapping[str, Any]]:
    """Read a track; a note of what was left out is printed.

    Raises:
        CommandFailed: If the file is not a track.
        MalformedDrive: If it is GPX or NMEA that cannot be used.
    """
    suffix = track.suffix.lower()
    if suffix == ".gpx":
        return read_gpx(track)
    text = track.read_text("utf-8-sig", "replace")
    if suffix == ".nmea" or (suffix not in _TABLES and is_nmea(text)):
        fixes, notes = read_nmea(track)
        for note in notes:
            say(note)
        return fixes
    try:
        rows = json.loads(text) if suffix == ".json" else _table(text)
        _require_fixes(rows)
    except (ValueError, csv.Error) as error:
        raise CommandFailed(f"{track}: {error}; {_WANTED}") from error
    except RecursionError:
        raise CommandFailed(f"{track}: it is nested too deep; {_WANTED}") from None
    for number, row in enumerate(rows, 1):
        for name, value in row.items():
            if isinstance(value, float) and not math.isfinite(value):
                raise CommandFailed(
                    f"{track}: fix {number} has {name} {value}, wanted a finite number, or none"
                    " where it is unknown"
                )
    return rows


def _table(text: str) -> list[dict[str, float]]:
    """Return the rows of a table, without empty cells.

    Raises:
        ValueError: If a column is missing, or a cell is no number.
        csv.Error: If it is no table.
    """
    table = csv.DictReader(text.splitlines())
    rows = []
    for row in table:
        cells = {name: row[name] for name in _KNOWN if (row.get(name) or "").strip()}
        try:
            rows.append({name: float(cell) for name, cell in cells.items()})
        except ValueError as error:
            raise ValueError(f"line {table.line_num}: {error}") from error
    columns = table.fieldnames or ()
    if rows and not set(_NEEDED) <= set(columns):
        raise ValueError(f"it has the columns {', '.join(columns)[:120]}")
    return rows


def _require_fixes(rows: object) -> None:
    """Raise `ValueError` unless these are fixes, at least one."""
    if not isinstance(rows, list) or not rows:
        raise ValueError("it has no fixes")
    for number, row in enumerate(rows, 1):
        if not isinstance(row, dict) or not set(_NEEDED) <= row.keys() <= set(_KNOWN):
            raise ValueError(f"fix {number} is {str(row)[:120]}")
