"""Geographic anchors: from the metres of a map to WGS84 and back.

A map's frame is taken as a plane that touches the ellipsoid: east, north and up at its anchor. Its
points are converted exactly, through geocentric coordinates. What is not exact is a map whose poses
are not such metres, for example those of a projection, whose scale differs.
"""

import math
from dataclasses import dataclass

import numpy as np

from core.arrays import FloatArray
from core.attributes import Attributes
from core.errors import InvalidParameters

_A_M, _FLATTENING = 6_378_137.0, 1.0 / 298.257223563  # WGS84, NIMA TR8350.2
_B_M = _A_M * (1.0 - _FLATTENING)
_E2, _SECOND_E2 = 1.0 - (_B_M / _A_M) ** 2, (_A_M / _B_M) ** 2 - 1.0
_ROUNDS = 3  # of Bowring's formula: 1e-9 m from -11 to 100 km
_BOUNDS = {
    "latitude_deg": 90.0,
    "longitude_deg": 180.0,
    "altitude_m": 100_000.0,
    "heading_deg": 360.0,
    "x_m": 1e8,
    "y_m": 1e8,
    "z_m": 1e8,
}


@dataclass(frozen=True)
class AnchorFit(Attributes):
    """How an anchor was fitted to the track of a GNSS receiver.

    Attributes:
        drive: The drive with the receiver.
        fixes: Number of fixes that were compared, some metres apart.
        agreeing: Number of these that it was fitted to.
        spread_m: Standard deviation of a fix in x and y, each.
        error_m: Standard deviation of the anchor's point.
        error_deg: Standard deviation of its heading.
        altitudes: Number of agreeing fixes that have an altitude: with 0 the anchor's is unknown,
            and is 0. `None` of an anchor that an earlier release fitted.
    """

    drive: str
    fixes: int
    agreeing: int
    spread_m: float
    error_m: float
    error_deg: float
    altitudes: int | None = None


@dataclass(frozen=True)
class Anchor(Attributes):
    """A point of a map whose place on the Earth is known, and how the map is turned.

    Attributes:
        latitude_deg: The point's geodetic latitude.
        longitude_deg: The point's longitude.
        altitude_m: Above the ellipsoid.
        heading_deg: The heading of the map's x axis, counter-clockwise from east.
        x_m: The point's x in the map; the map's origin by default.
        y_m: The point's y in the map.
        z_m: The point's z in the map.
        fitted: How it was fitted, `None` if it was set.

    Examples:
        >>> anchor = Anchor(49.0, 8.4)
        >>> anchor.wgs84(np.array([[0.0, 1852.0, 0.0]])).round(4).tolist()
        [[49.0167, 8.4, 0.2691]]
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0
    heading_deg: float = 0.0
    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    fitted: AnchorFit | None = None

    def __post_init__(self) -> None:
        for name, most in _BOUNDS.items():
            value = float(getattr(self, name))
            object.__setattr__(self, name, value)
            if not -most <= value <= most:
                raise InvalidParameters(f"{name} is {value}, wanted {-most:g}..{most:g}")

    def wgs84(self, points_m: FloatArray) -> FloatArray:
        """Return latitude and longitude in degrees and the altitude of `(n, 3)` points."""
        latitude, longitude, altitude_m = self._geodetic(points_m)
        return np.stack([np.degrees(latitude), np.degrees(longitude), altitude_m], axis=1)

    def level_m(self, places: FloatArray) -> FloatArray:
        """Return metres east, north and up of the anchor's point, `(n, 3)`.

        Args:
            places: `(n, 3)` latitudes and longitudes in degrees and altitudes.
        """
        at = np.array([[self.latitude_deg, self.longitude_deg, self.altitude_m]])
        return np.asarray((geocentric_m(places) - geocentric_m(at)) @ _axes(*self._at))

    def pose_wgs84(self, x_m: float, y_m: float, z_m: float, yaw_deg: float) -> dict[str, float]:
        """Return the place of a pose in plain values.

        Args:
            x_m: The pose's x in the map.
            y_m: The pose's y in the map.
            z_m: The pose's z in the map.
            yaw_deg: Heading in the map, counter-clockwise from x.

        Returns:
            `latitude_deg`, `longitude_deg`, `altitude_m`, and `bearing_deg`: the heading clockwise
            from true north, 0..360.
        """
        latitude, longitude, altitude_m = (
            float(value[0]) for value in self._geodetic(np.array([[x_m, y_m, z_m]]))
        )
        turn = math.radians(yaw_deg + self.heading_deg)
        ahead = _axes(*self._at) @ np.array([math.cos(turn), math.sin(turn), 0.0])
        east, north, _ = (_axes(latitude, longitude).T @ ahead).tolist()
        bearing_deg = math.degrees(math.atan2(east, north)) % 360.0
        return {
            "latitude_deg": math.degrees(latitude),
            "longitude_deg": math.degrees(longitude),
            "altitude_m": altitude_m,
            "bearing_deg": bearing_deg % 360.0,  # just below 0 the first remainder is 360
        }

    @property
    def _at(self) -> tuple[float, float]:
        return math.radians(self.latitude_deg), math.radians(self.longitude_deg)

    def _geodetic(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        turn = math.radians(self.heading_deg)
        cos, sin = math.cos(turn), math.sin(turn)
        x_m, y_m, z_m = (points_m - [self.x_m, self.y_m, self.z_m]).T
        level_m = np.stack([x_m * cos - y_m * sin, x_m * sin + y_m * cos, z_m])
        origin_m = geocentric_m(
            np.array([[self.latitude_deg, self.longitude_deg, self.altitude_m]])
        )
        return _geodetic_of(origin_m.T + _axes(*self._at) @ level_m)


def geocentric_m(places: FloatArray) -> FloatArray:
    """Return geocentric x, y, z of `(n, 3)` latitudes and longitudes in degrees and altitudes."""
    latitude, longitude, altitude_m = (
        np.radians(places[:, 0]),
        np.radians(places[:, 1]),
        places[:, 2],
    )
    normal_m = _A_M / np.sqrt(1.0 - _E2 * np.sin(latitude) ** 2)
    level_m = (normal_m + altitude_m) * np.cos(latitude)
    up_m = (normal_m * (1.0 - _E2) + altitude_m) * np.sin(latitude)
    return np.stack([level_m * np.cos(longitude), level_m * np.sin(longitude), up_m], axis=1)


def _geodetic_of(geocentric: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return latitude, longitude in radians and altitude of `(3, n)` points (Bowring 1976)."""
    x_m, y_m, z_m = geocentric
    level_m = np.hypot(x_m, y_m)
    reduced = np.arctan2(z_m * _A_M, level_m * _B_M)
    for _ in range(_ROUNDS):
        latitude = np.arctan2(
            z_m + _SECOND_E2 * _B_M * np.sin(reduced) ** 3,
            level_m - _E2 * _A_M * np.cos(reduced) ** 3,
        )
        reduced = np.arctan2(_B_M * np.sin(latitude), _A_M * np.cos(latitude))
    altitude_m = (
        level_m * np.cos(latitude)
        + z_m * np.sin(latitude)
        - _A_M * np.sqrt(1.0 - _E2 * np.sin(latitude) ** 2)
    )
    return latitude, np.arctan2(y_m, x_m), altitude_m


def _axes(latitude: float, longitude: float) -> FloatArray:
    """Return east, north and up in geocentric coordinates, the columns of `(3, 3)`."""
    sin, cos = math.sin(latitude), math.cos(latitude)
    sin_east, cos_east = math.sin(longitude), math.cos(longitude)
    return np.array(
        [
            [-sin_east, -sin * cos_east, cos * cos_east],
            [cos_east, -sin * sin_east, cos * sin_east],
            [0.0, cos, sin],
        ]
    )
