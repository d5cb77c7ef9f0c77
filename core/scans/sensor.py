"""Sensors and the angular grids their scans are rounded to (paper, sec. 2.1)."""

import math
from dataclasses import asdict, dataclass

import numpy as np

from core.arrays import FloatArray
from core.errors import InvalidParameters
from core.numbers import require_above, require_at_least
from core.scans.beams import (
    HDL_64E_BEAMS_DEG,
    PANDAR40_BEAMS_DEG,
    PANDAR64_BEAMS_DEG,
    PANDAR128_BEAMS_DEG,
    RS_32_BEAMS_DEG,
    RS_128_BEAMS_DEG,
    VLS_128_BEAMS_DEG,
)

HDL_64E_ON_KITTI_HEIGHT_M = 1.73  # KITTI's sensor set-up: above ground
_MIN_STEP_DEG = 1e-3
MAX_CELLS = 4_000_000
"""Most cells of a grid: one of a hundredth of a degree is a typing error, not a sensor."""


def require_lattice(azimuth_step_deg: float, rows: int, columns: int) -> None:
    """Reject a grid whose azimuths do not fill half a revolution, or that has too many cells.

    Raises:
        InvalidParameters: If it is such a grid.
    """
    half_turn = 180.0 / azimuth_step_deg
    if abs(half_turn - round(half_turn)) > 1e-9 * half_turn:
        raise InvalidParameters(
            f"azimuth_step_deg is {azimuth_step_deg}, which does not divide 180"
        )
    if rows * columns > MAX_CELLS:
        raise InvalidParameters(
            f"the grid has {rows} x {columns} cells, wanted at most {MAX_CELLS}"
        )


@dataclass(frozen=True)
class AngularGrid:
    """The lattice of whole steps of elevation and azimuth that returns are rounded to.

    The paper's lattice is the default: one degree, elevation -25..4, azimuth -180..180, so that
    -180 and 180 are one direction split in half. A grid that `wraps` joins them: 360 columns.

    Examples:
        >>> AngularGrid().shape
        (30, 361)
        >>> AngularGrid(wraps=True).shape
        (30, 360)
    """

    elevation_min_deg: float = -25.0
    elevation_step_deg: float = 1.0
    rows: int = 30
    azimuth_step_deg: float = 1.0
    wraps: bool = False

    def __post_init__(self) -> None:
        # 1 and 1.0 are one grid, and must be one digest.
        for name in ("elevation_min_deg", "elevation_step_deg", "azimuth_step_deg"):
            object.__setattr__(self, name, float(getattr(self, name)))
        object.__setattr__(self, "wraps", bool(self.wraps))
        for name in ("elevation_step_deg", "azimuth_step_deg"):
            if not _MIN_STEP_DEG <= getattr(self, name) <= 90.0:
                raise InvalidParameters(
                    f"{name} is {getattr(self, name)}, wanted {_MIN_STEP_DEG}..90"
                )
        if not -90.0 <= self.elevation_min_deg <= 90.0:
            raise InvalidParameters(
                f"elevation_min_deg is {self.elevation_min_deg}, wanted -90..90"
            )
        if self.rows != self.rows // 1 or not 1 <= self.rows <= MAX_CELLS:
            raise InvalidParameters(f"rows is {self.rows}, wanted a whole number, at least 1")
        object.__setattr__(self, "rows", int(self.rows))
        highest_deg = self.elevation_min_deg + self.elevation_step_deg * (self.rows - 1)
        if highest_deg > 90.0 + 1e-9:
            raise InvalidParameters(f"the highest elevation is {highest_deg:g}, wanted up to 90")
        require_lattice(self.azimuth_step_deg, self.rows, self.columns)

    @property
    def columns(self) -> int:
        """How many azimuths: a full turn, and the split direction once more unless it wraps."""
        return round(360.0 / self.azimuth_step_deg) + (not self.wraps)

    @property
    def shape(self) -> tuple[int, int]:
        """`(I, J)`: elevations, azimuths."""
        return self.rows, self.columns

    def as_attributes(self) -> dict[str, float | int | bool]:
        """Return plain values for a file's attributes."""
        return asdict(self)

    @property
    def elevations_deg(self) -> FloatArray:
        """The elevation of each row, `(I,)`."""
        return self.elevation_min_deg + self.elevation_step_deg * np.arange(
            self.rows, dtype=np.float64
        )

    @property
    def azimuths_deg(self) -> FloatArray:
        """The azimuth of each column, `(J,)`."""
        return -180.0 + self.azimuth_step_deg * np.arange(self.columns, dtype=np.float64)


@dataclass(frozen=True)
class Sensor:
    """A LiDAR model and its grid.

    A spinning sensor has the same beams in each scan. One whose pattern does not repeat has other
    rays in each scan; here they are spread evenly over its field of view, taken as a rectangle.

    Attributes:
        name: The short name that commands, requests and maps use.
        grid: Default lattice; one row per beam where beams are evenly spaced.
        source: The publication with the figures.
        rays_per_scan: Rays in 0.1 s at ten scans a second, one return each: beams times azimuths,
            or a tenth of the point rate of one whose pattern does not repeat.
        height_m: The sensor's usual height above ground, `None` if vehicles differ.
        uneven_beams_deg: Elevation of each beam, rising, where they are not those of the grid; of
            one whose pattern does not repeat the lowest and the highest.
        fov_deg: Horizontal field of view, around the front.
        repeats: Whether each scan has the same rays.
    """

    name: str
    grid: AngularGrid
    source: str
    rays_per_scan: int
    height_m: float | None = None
    uneven_beams_deg: tuple[float, ...] = ()
    fov_deg: float = 360.0
    repeats: bool = True

    def __post_init__(self) -> None:
        require_at_least(1, rays_per_scan=self.rays_per_scan)
        require_above(0, fov_deg=self.fov_deg)
        if self.fov_deg > 360.0:
            raise InvalidParameters(f"fov_deg is {self.fov_deg}, wanted up to 360")
        if list(self.uneven_beams_deg) != sorted(self.uneven_beams_deg):
            raise InvalidParameters("uneven_beams_deg does not rise")

    @property
    def beams_deg(self) -> FloatArray:
        """The elevation of each beam, `(b,)`, rising; of lines as far apart as its rays if none."""
        if not self.uneven_beams_deg:
            return self.grid.elevations_deg
        if self.repeats:
            return np.array(self.uneven_beams_deg)
        lowest_deg, highest_deg = self.uneven_beams_deg
        height_deg = highest_deg - lowest_deg
        apart_deg = math.sqrt(self.fov_deg * height_deg / self.rays_per_scan)
        return np.linspace(lowest_deg, highest_deg, round(height_deg / apart_deg) + 1)

    @property
    def azimuths(self) -> int:
        """How many azimuths a full turn has, or would have if the field of view were one."""
        return round(self.rays_per_scan / len(self.beams_deg) * 360.0 / self.fov_deg)

    def height_or_assumed_m(self, given_m: float | None = None) -> float:
        """Return the height above ground: as given, the sensor's own, or that of an HDL-64E."""
        if given_m is not None:
            return given_m
        return HDL_64E_ON_KITTI_HEIGHT_M if self.height_m is None else self.height_m

    def height_note(self, given_m: float | None) -> str | None:
        """Return a note if the height is neither given nor known."""
        if given_m is not None or self.height_m is not None:
            return None
        return (
            f"sensor_height_m is not given and {self.name} has no default:"
            f" {HDL_64E_ON_KITTI_HEIGHT_M} m above ground is assumed; give the height of yours,"
            " as height images depend on it"
        )


def _even_beams(lowest_deg: float, highest_deg: float, beams: int) -> AngularGrid:
    step = (highest_deg - lowest_deg) / (beams - 1)
    return AngularGrid(elevation_min_deg=lowest_deg, elevation_step_deg=step, rows=beams)


_MINUS_25_TO_15 = AngularGrid(rows=41)
_EVEN = "; each unit is calibrated, here evenly spread between these limits"
_OUSTER_COLUMNS = 1024  # at ten scans a second, by default
_OUSTER = (("os0", 45.0), ("os1", 22.5), ("os2", 11.25))
"""Models and their highest elevation, the negative of their lowest."""

HDL_64E = Sensor(
    "hdl-64e",
    AngularGrid(),
    "paper, sec. 2.1: 26.3 deg of elevation, 30 whole degrees -25..4",
    64 * 2083,
    HDL_64E_ON_KITTI_HEIGHT_M,
    tuple(sorted(HDL_64E_BEAMS_DEG)),
)


def _livox(
    name: str,
    lowest_deg: float,
    highest_deg: float,
    fov_deg: float,
    points_per_s: int,
    source: str,
) -> Sensor:
    first = math.floor(lowest_deg)
    return Sensor(
        name,
        AngularGrid(elevation_min_deg=first, rows=math.ceil(highest_deg) - first + 1),
        f"{source}; its pattern does not repeat, here evenly spread over the field of view",
        points_per_s // 10,
        uneven_beams_deg=(lowest_deg, highest_deg),
        fov_deg=fov_deg,
        repeats=False,
    )


SENSORS: dict[str, Sensor] = {
    sensor.name: sensor
    for sensor in (
        HDL_64E,
        Sensor(
            "hdl-32e",
            _even_beams(-92.0 / 3.0, 32.0 / 3.0, 32),
            "Velodyne HDL-32E datasheet 97-0038: +10.67..-30.67 deg, 32 beams 1.33 deg apart",
            32 * 2170,
        ),
        Sensor(
            "vlp-16",
            _even_beams(-15.0, 15.0, 16),
            "Velodyne VLP-16 datasheet 63-9229: +15..-15 deg, 16 beams 2 deg apart",
            16 * 1808,
        ),
        Sensor(
            "vls-128",
            _MINUS_25_TO_15,
            "Velodyne VLS-128 (Alpha Prime) manual: +15..-25 deg, 0.11 deg apart at the horizon;"
            " each beam as in two public drivers",
            128 * 1876,
            uneven_beams_deg=VLS_128_BEAMS_DEG,
        ),
        *(
            Sensor(
                f"{model}-{channels}",
                _even_beams(-limit_deg, limit_deg, channels),
                f"Ouster {model.upper()} datasheet: {2 * limit_deg:g} deg of elevation"
                f" (+{limit_deg:g}..-{limit_deg:g}), {channels} channels{_EVEN}",
                channels * _OUSTER_COLUMNS,
            )
            for model, limit_deg in _OUSTER
            for channels in (32, 64, 128)
        ),
        Sensor(
            "pandar40",
            _MINUS_25_TO_15,
            "Hesai Pandar40 manual, appendix I: +15..-25 deg, 0.33 deg apart at the horizon",
            40 * 1800,
            uneven_beams_deg=PANDAR40_BEAMS_DEG,
        ),
        Sensor(
            "pandar64",
            _MINUS_25_TO_15,
            "Hesai Pandar64: +15..-25 deg, 0.167 deg apart at the horizon; each beam as in the"
            " default of Hesai's general SDK",
            64 * 1800,
            uneven_beams_deg=PANDAR64_BEAMS_DEG,
        ),
        Sensor(
            "pandar128",
            _MINUS_25_TO_15,
            "Hesai Pandar128: +15..-25 deg, 0.125 deg apart at the horizon; each beam as in the"
            " default correction file of Hesai's ROS driver",
            64 * 1800 + 64 * 3600,
            uneven_beams_deg=PANDAR128_BEAMS_DEG,
        ),
        Sensor(
            "rs-16",
            _even_beams(-15.0, 15.0, 16),
            "RoboSense RS-LiDAR-16 manual: +15..-15 deg, 16 beams 2 deg apart",
            16 * 2000,
        ),
        Sensor(
            "rs-32",
            _MINUS_25_TO_15,
            "RoboSense RS-LiDAR-32 manual: +15..-25 deg, 0.333 deg apart at the horizon; each beam"
            " within 0.06 deg of two published calibrations",
            32 * 2000,
            uneven_beams_deg=RS_32_BEAMS_DEG,
        ),
        Sensor(
            "rs-128",
            _MINUS_25_TO_15,
            "RoboSense RS-Ruby manual: +15..-25 deg, 0.1 deg apart at the horizon; each beam within"
            " 0.07 deg of a published calibration of an RS-Ruby Plus",
            128 * 1800,
            uneven_beams_deg=RS_128_BEAMS_DEG,
        ),
        _livox(
            "mid-360", -7.0, 52.0, 360.0, 200_000,
            "Livox Mid-360 datasheet: 360 deg x -7..52 deg, 200,000 points/s",
        ),
        _livox(
            "horizon", -12.55, 12.55, 81.7, 240_000,
            "Livox Horizon manual: 81.7 deg x 25.1 deg, 240,000 points/s",
        ),
        _livox(
            "avia", -38.6, 38.6, 70.4, 240_000,
            "Livox Avia manual: 70.4 deg x 77.2 deg, 240,000 points/s",
        ),
        _livox(
            "hap", -12.5, 12.5, 120.0, 452_000,
            "Livox HAP (TX) manual: 120 deg x 25 deg, 452,000 points/s",
        ),
    )
}  # fmt: skip


def sensor_named(name: str) -> Sensor:
    """Return the sensor of that name.

    Raises:
        InvalidParameters: If there is none; the message lists those there are.
    """
    try:
        return SENSORS[name.lower()]
    except KeyError:
        raise InvalidParameters(
            f"there is no sensor {name!r}; known are {', '.join(sorted(SENSORS))}"
        ) from None


def whole_and_fraction(offset: float) -> tuple[int, float]:
    """Split a grid offset, in steps, so that angles themselves are rounded half to even.

    `rint(angle / step - fraction) - whole` is the index; with the paper's whole-degree grid the
    fraction is 0 and the angle itself is rounded.
    """
    whole = math.floor(offset + 0.5)
    return whole, offset - whole
