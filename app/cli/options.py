"""Options that several commands share, and how comma-separated lists are read."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from app.builds.parameters import Align
from app.cli.console import say_note
from app.http.field_problems import wanted_and_got
from core.encodings.compression import Compression
from core.encodings.distance import Distance
from core.encodings.registry import encoding_names
from core.errors import InvalidParameters
from core.parameters import Segmentation
from core.projection.imager import ImageKind, Views
from core.projection.reducer import Reducer
from core.scans.accumulation import MOST_SCANS
from core.scans.drive import Drive
from core.scans.mounting import Mounting, vehicle_drive
from core.scans.sensor import HDL_64E, SENSORS, sensor_named
from core.segmentation.fixed import PAPER_SEGMENT_LENGTH
from storage.formats.drives.layouts import open_drive
from storage.formats.scans.registry import FORMAT_NAMES

MIN_RETURNS = 100
"""A scan file with fewer finite, non-zero returns is rejected, as by the service's default."""

_OPTIONS = {"lateral_renderings_m": "--lateral-renderings"}
"""Options that are not named as the field of a build's parameters that they set."""

_build: Any = partial(typer.Option, rich_help_panel="Map")

_LAYOUTS = "KITTI odometry, NCLT, MulRan, HeLiPR or Ford Campus layout, or scan files"
_TOPIC = "'monday.bag#/points' names the topic of one with several."

DriveArgument = Annotated[
    Path,
    typer.Argument(
        help=f"Folder of a drive: {_LAYOUTS}; or a Velodyne .pcap, or a ROS bag; {_TOPIC}",
        metavar="DRIVE",
    ),
]
DrivesArgument = Annotated[
    list[Path],
    typer.Argument(
        help=f"Folders of drives: {_LAYOUTS}; or Velodyne .pcap files, or ROS bags; {_TOPIC}",
        metavar="DRIVE...",
    ),
]
DataOption = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="The service's data. [data]", envvar="TENSORMAP_DATA_DIR"),
]
MapArgument = Annotated[Path, typer.Argument(help="A map file.", metavar="MAP.h5")]
FormatOption = Annotated[
    str | None,
    typer.Option(
        "--format",
        help=f"Format of the scan files, by default by suffix: {', '.join(FORMAT_NAMES)}.",
    ),
]
EncodingOption = Annotated[
    str | None,
    _build(
        metavar="|".join(encoding_names()),
        help="Encoding; by default harmonic, or paper with a reducer that only the paper's has.",
    ),
]
SegmentationOption = Annotated[
    Segmentation,
    _build(
        help="k scans each, or k/2 to 2k: cut where the drive turns or its surroundings change."
    ),
]
SegmentLengthOption = Annotated[int | None, _build(min=1, help="Number of scans in a segment, k.")]
SegmentsOption = Annotated[
    int | None,
    _build(
        min=1,
        help="Number of segments L, in place of k: k = ceil(K / L) of the longest drive. Turns, in"
        " harmonic maps, and places where drives meet add segments. [k fits the longest drive, at"
        f" most {PAPER_SEGMENT_LENGTH}]",
    ),
]
ReducerOption = Annotated[
    Reducer | None,
    _build(help="Which return a shared cell keeps. [last; harmonic: highest, of ranges mean]"),
]
ImageOption = Annotated[
    ImageKind | None,
    _build(help="Kind of image to encode. [range; harmonic: height]"),
]
DistanceOption = Annotated[
    Distance | None,
    _build(help="How harmonic signatures are compared. [normalised]"),
]
ViewsOption = Annotated[
    Views | None,
    _build(
        help="`any`: scans are levelled, and queries may see a part of their place; `full`: they"
        " are level and see all around. [any in harmonic maps of heights, else full]"
    ),
]
VerificationOption = Annotated[
    bool | None,
    _build(
        "--verification-images/--no-verification-images",
        help="Keep a small image of each scan: the best candidates of a scan query are compared"
        " with them cell by cell. [where views are any]",
    ),
]
AlignOption = Annotated[
    Align,
    _build(
        help="`check` rejects drives whose poses are in different world frames, `auto` aligns them,"
        " `off` does neither."
    ),
]
SensorOption = Annotated[str, _build(help=f"Sensor: one of {', '.join(sorted(SENSORS))}.")]
SensorHeightOption = Annotated[
    float | None,
    _build(
        help=f"Height of the sensor above ground, in metres. [{HDL_64E.height_m}:"
        f" {HDL_64E.name} on a car]"
    ),
]


def mounting(text: str) -> Mounting:
    """Read `x,y,z,roll,pitch,yaw`.

    Raises:
        typer.BadParameter: If it is something else.

    Examples:
        >>> mounting("1.2,0,1.9,0,5,0").z_m
        1.9
    """
    try:
        return Mounting.from_text(text)
    except InvalidParameters as error:
        raise typer.BadParameter(str(error)) from None


_mounting: Any = partial(typer.Option, parser=mounting, metavar="X,Y,Z,ROLL,PITCH,YAW")

MountingOption = Annotated[
    Mounting | None,
    _mounting(
        help="Mounting of the sensor in the vehicle's frame, metres and degrees; Z is above the"
        " ground."
    ),
]
QueryMountingOption = Annotated[
    Mounting | None,
    _mounting(
        help="Mounting of DRIVE2's and DRIVE3's sensor, if it is another.",
        rich_help_panel="Protocol",
    ),
]
RollOption = Annotated[
    float | None,
    typer.Option(help="Roll of the vehicle against gravity, right side down; with --pitch-deg."),
]
PitchOption = Annotated[
    float | None,
    typer.Option(
        help="Pitch of the vehicle against gravity, front down; with --roll-deg. Both level the"
        " scan."
    ),
]
AccumulateOption = Annotated[
    int,
    typer.Option(
        min=1,
        max=MOST_SCANS,
        help="Number of consecutive scans that become one; the drive needs poses.",
    ),
]


ForceOption = Annotated[bool, typer.Option("--force", help="Replace the map file if it is there.")]
OdometryOption = Annotated[
    bool,
    _build(
        "--odometry/--no-odometry",
        help="Compute the poses of drives that have none; the extra `odometry` does.",
    ),
]


def open_mapped(
    path: Path, mounting: Mounting | None, sensor_height_m: float, accumulate: int = 1
) -> Drive:
    """Open a recorded drive as the service would build a map of it.

    Args:
        path: The drive's path.
        mounting: The mounting of the drive's sensor.
        sensor_height_m: The map's sensor height.
        accumulate: How many consecutive scans become one.
    """
    return vehicle_drive(open_recorded(path), mounting, sensor_height_m, accumulate)


def open_recorded(path: Path) -> Drive:
    """Open a drive as its sensor recorded it; scans of too few returns are not usable."""
    return open_drive(path, min_returns=MIN_RETURNS)


def given_height_m(sensor_height_m: float | None, mounting: Mounting | None) -> float | None:
    """Return the height above ground as given, or that of the mounting."""
    return mounting.z_m if sensor_height_m is None and mounting is not None else sensor_height_m


def height_m(sensor: str, given_m: float | None) -> float:
    """Return the sensor's height above ground; one that is only assumed is noted.

    Raises:
        InvalidParameters: If there is no such sensor.
    """
    known = sensor_named(sensor)
    note = known.height_note(given_m)
    if note is not None:
        say_note(note)
    return known.height_or_assumed_m(given_m)


def invalid(error: ValidationError) -> typer.BadParameter:
    """Return the error about options, of the first problem of the parameters that they make."""
    fault = error.errors()[0]
    field = str(fault["loc"][0]) if fault["loc"] else ""  # none: of several together
    option = _OPTIONS.get(field, field and f"--{field.replace('_', '-')}")
    return typer.BadParameter(f"{option} {wanted_and_got(fault)}".lstrip())


def checked(read: Callable[[Any], object]) -> Callable[[Any], Any]:
    """Return a callback that parses an option's text, so that an error names the option."""

    def check(text: str | None) -> str | None:
        if text is not None:
            read(text)
        return text

    return check


def numbers(text: str) -> tuple[float, ...]:
    """Read a comma-separated list of numbers.

    Raises:
        typer.BadParameter: If an item is no number.

    Examples:
        >>> numbers("0,1,-1.5")
        (0.0, 1.0, -1.5)
    """
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is no comma-separated list of numbers") from None


LateralRenderingsOption = Annotated[
    str | None,
    _build(
        "--lateral-renderings",
        help="Viewpoints from which a harmonic map's scans are rendered, metres to the left,"
        " comma-separated. [-3,-1.5,0,1.5,3]",
        callback=checked(numbers),
    ),
]


def ranks(text: str | None) -> tuple[int, int] | None:
    """Read `r1,r2`, the encoding's default if there is no text.

    Raises:
        typer.BadParameter: If it is something else.

    Examples:
        >>> ranks("5,5")
        (5, 5)
    """
    if text is None:
        return None
    first, comma, second = text.partition(",")
    if not (comma and first.strip().isdecimal() and second.strip().isdecimal()):
        raise typer.BadParameter(f"{text!r} is no pair of whole numbers r1,r2")
    return int(first), int(second)


RanksOption = Annotated[
    str | None,
    _build(
        "--ranks",
        help="r1,r2: the shape of a signature; 6,7 for any views, else 5,5.",
        callback=checked(ranks),
    ),
]


def of_verification(size_bytes: int) -> str:
    """Return how many bytes are of verification images, as the end of a phrase."""
    return f", {size_bytes} of verification images" if size_bytes else ""


def ratios(compression: Compression) -> str:
    """Return the numbers in a map, its images and their returns, in proportion."""
    return (
        f"map : images : returns = 1 : {compression.tensor_ratio:.1f} :"
        f" {compression.returns_ratio:.0f}"
    )
