"""Sensors and the angular grids their scans are rounded to (paper, sec. 2.1)."""

import math
from dataclasses import asdict, dataclass

import numpy as np

from core.arrays import FloatArray
from core.errors import InvalidParameters

HDL_64E_ON_KITTI_HEIGHT_M = 1.73  # KITTI's sensor set-up: above ground
_MIN_STEP_DEG = 1e-3
MAX_CELLS = 4_000_000
"""Of a grid: one of a hundredth of a degree is a typing error, not a sensor."""


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

    Attributes:
        name: The short name that commands, requests and maps use.
        grid: Default lattice; one row per beam where beams are evenly spaced.
        source: Where the figures are published.
        height_m: Its usual height above ground, `None` if vehicles differ.
    """

    name: str
    grid: AngularGrid
    source: str
    height_m: float | None = None

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


HDL_64E = Sensor(
    "hdl-64e",
    AngularGrid(),
    "paper, sec. 2.1: 26.3 deg of elevation, 30 whole degrees -25..4",
    HDL_64E_ON_KITTI_HEIGHT_M,
)

SENSORS: dict[str, Sensor] = {
    sensor.name: sensor
    for sensor in (
        HDL_64E,
        Sensor(
            "hdl-32e",
            _even_beams(-92.0 / 3.0, 32.0 / 3.0, 32),
            "Velodyne HDL-32E datasheet 97-0038: +10.67..-30.67 deg, 32 beams 1.33 deg apart",
        ),
        Sensor(
            "vlp-16",
            _even_beams(-15.0, 15.0, 16),
            "Velodyne VLP-16 datasheet 63-9229: +15..-15 deg, 16 beams 2 deg apart",
        ),
        Sensor(
            "os0-64",
            _even_beams(-45.0, 45.0, 64),
            "Ouster OS0 datasheet: 90 deg of elevation (+45..-45), 64 channels",
        ),
        Sensor(
            "os1-64",
            _even_beams(-22.5, 22.5, 64),
            "Ouster OS1 datasheet: 45 deg of elevation (+22.5..-22.5), 64 channels",
        ),
    )
}


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
