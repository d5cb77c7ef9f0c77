"""Disturbances of scans: what other traffic hides, what a sensor lacks, and how a vehicle moves.

Each is named and parametrised by one text, such as `hidden:60`; `parse_disturbances` reads lists
of them. All work in the frame of the scan: x forward, y left, z up. That is the sensor's, but where
it is mounted its vehicle's: there, what a sensor lacks is found as seen from the sensor.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from core.arrays import BoolArray, FloatArray
from core.errors import InvalidParameters
from core.scans.angles import wrapped_deg
from core.scans.mounting import Mounting
from core.scans.sensor import (
    HDL_64E,
    HDL_64E_ON_KITTI_HEIGHT_M,
    SENSORS,
    Sensor,
    sensor_named,
)

TRUCK_LENGTH_M, TRUCK_WIDTH_M, TRUCK_TOP_M = 12.0, 2.5, 4.0
TRUCK_BESIDE_M = 3.2
"""From the sensor to a truck's centre line."""
TRUCK_BEHIND_M = (4.0, 8.0)
"""How far behind the sensor a truck's rear end is."""
SNOW_SHAPE, SNOW_SCALE_M, SNOW_LEAST_M = 2.0, 2.5, 0.5
"""The gamma distribution of the distance of a flake."""
TURN_S = 0.1
"""The time of a turn of the sensor."""
SKEW_YAW_RATE_DEG_S = 30.0


@dataclass(frozen=True)
class Recording:
    """What disturbances know of the sensor that recorded a scan.

    Attributes:
        sensor: The model.
        height_m: Height of the scan's origin above ground.
        mounting: The sensor's mounting, if scans are in the vehicle's frame.
        turned_deg: How far the vehicle is turned to the left, where the sensor recorded as it was.
    """

    sensor: Sensor
    height_m: float
    mounting: Mounting | None = None
    turned_deg: float = 0.0


KITTI_RECORDING = Recording(HDL_64E, HDL_64E_ON_KITTI_HEIGHT_M)


@dataclass(frozen=True)
class Disturbance:
    """One disturbance of a scan.

    Attributes:
        name: The kind's name, such as `hidden`.
        value: The kind's parameter, as `DISTURBANCES` describes it: a number, or the name of a
            sensor.
    """

    name: str
    value: float | str

    def __post_init__(self) -> None:
        kind = DISTURBANCES.get(self.name)
        if kind is None:
            raise InvalidParameters(
                f"there is no disturbance {self.name!r}; known are {', '.join(DISTURBANCES)}"
            )
        if isinstance(self.value, str):
            if self.name != "beams":
                raise InvalidParameters(f"{self} has no number, wanted {kind.wanted}")
            sensor_named(self.value)
        elif not kind.lowest <= self.value <= kind.highest or (kind.is_whole and self.value % 1):
            raise InvalidParameters(f"{self} is out of range, wanted {kind.wanted}")

    def __str__(self) -> str:
        value = self.value if isinstance(self.value, str) else format(self.value, "g")
        return f"{self.name}:{value}"

    def apply(
        self, points_m: FloatArray, recording: Recording, rng: np.random.Generator
    ) -> FloatArray:
        """Return the disturbed returns, `(n', 3)` in metres.

        Args:
            points_m: `(n, 3)` in metres, none at the origin.
            recording: How they were recorded.
            rng: The source of centres, sides and losses.
        """
        kind, mounting = DISTURBANCES[self.name], recording.mounting
        if mounting is None or not kind.is_of_sensor:
            return kind.apply(points_m, self.value, recording, rng)
        vehicle = recording.height_m, recording.turned_deg
        seen_m = mounting.seen_by_sensor(points_m, *vehicle)
        found_m = kind.apply(seen_m, self.value, recording, rng)
        return mounting.seen_by_vehicle(found_m, *vehicle)


def parse_disturbance(text: str) -> Disturbance:
    """Return the disturbance that a text such as `hidden:60` or `beams:vlp-16` names.

    Raises:
        InvalidParameters: If there is none of that name or its value is out of range.

    Examples:
        >>> str(parse_disturbance("hidden:60"))
        'hidden:60'
    """
    name, colon, value = text.strip().partition(":")
    if not colon:
        raise InvalidParameters(f"{text!r} is not a disturbance, wanted NAME:VALUE as hidden:60")
    try:
        return Disturbance(name, float(value))
    except ValueError:
        return Disturbance(name, value)


def parse_disturbances(text: str) -> tuple[tuple[Disturbance, ...], ...]:
    """Return the combinations that a text such as `hidden:60+truck:1,fov:120` lists.

    Items separated by commas are one combination each; `+` applies several to one scan, from left
    to right. An empty item is the undisturbed scan.

    Raises:
        InvalidParameters: As in `parse_disturbance`.

    Examples:
        >>> [len(combined) for combined in parse_disturbances("hidden:60+truck:1,fov:120,")]
        [2, 1, 0]
    """
    return tuple(
        tuple(parse_disturbance(part) for part in item.split("+")) if item.strip() else ()
        for item in text.split(",")
    )


def _azimuth_deg(points_m: FloatArray) -> FloatArray:
    return np.degrees(np.arctan2(points_m[:, 1], points_m[:, 0]))


def _within_deg(points_m: FloatArray, centre_deg: float, width_deg: float) -> BoolArray:
    """Return which returns are in a sector, `(n,)`."""
    off_deg = wrapped_deg(_azimuth_deg(points_m) - centre_deg)
    within: BoolArray = np.abs(off_deg) <= width_deg / 2.0
    return within


def _hidden(
    points_m: FloatArray, width_deg: float, _: Recording, rng: np.random.Generator
) -> FloatArray:
    return points_m[~_within_deg(points_m, rng.uniform(-180.0, 180.0), width_deg)]


def _fov(
    points_m: FloatArray, width_deg: float, _: Recording, _rng: np.random.Generator
) -> FloatArray:
    return points_m[_within_deg(points_m, 0.0, width_deg)]


def _truck(
    points_m: FloatArray, trucks: float, recording: Recording, rng: np.random.Generator
) -> FloatArray:
    sides = (1.0, -1.0) if trucks == 2 else (rng.choice([1.0, -1.0]),)
    bottom_m = -recording.height_m
    share = np.ones(len(points_m))
    for side in sides:
        rear_m = -rng.uniform(*TRUCK_BEHIND_M)
        middle_m = side * TRUCK_BESIDE_M
        lowest_m = np.array([rear_m, middle_m - TRUCK_WIDTH_M / 2.0, bottom_m])
        highest_m = np.array(
            [rear_m + TRUCK_LENGTH_M, middle_m + TRUCK_WIDTH_M / 2.0, bottom_m + TRUCK_TOP_M]
        )
        share = np.minimum(share, _share_to_box(points_m, lowest_m, highest_m))
    return points_m * share[:, None]


def _share_to_box(points_m: FloatArray, lowest_m: FloatArray, highest_m: FloatArray) -> FloatArray:
    """Return at which share of its way each ray from the origin enters a box, 1 if it does not."""
    with np.errstate(divide="ignore", invalid="ignore"):
        to_lowest, to_highest = lowest_m / points_m, highest_m / points_m
    # 0 / 0: the ray runs in a face; it is taken as inside of that slab.
    first = np.fmin(to_lowest, to_highest).max(axis=1, initial=0.0)
    last = np.fmax(to_lowest, to_highest).min(axis=1)
    return np.where((first <= last) & (first > 0.0) & (first < 1.0), first, 1.0)


def _tilted(
    points_m: FloatArray,
    angle_deg: float,
    _: Recording,
    rng: np.random.Generator,
    *,
    axis: str,
) -> FloatArray:
    signed_deg = angle_deg * rng.choice([1.0, -1.0])
    return np.asarray(Rotation.from_euler(axis, signed_deg, degrees=True).apply(points_m))


def _height(
    points_m: FloatArray, higher_m: float, _: Recording, _rng: np.random.Generator
) -> FloatArray:
    return np.asarray(points_m - np.array([0.0, 0.0, higher_m]))


def _reach(
    points_m: FloatArray, reach_m: float, _: Recording, _rng: np.random.Generator
) -> FloatArray:
    kept: BoolArray = np.linalg.norm(points_m, axis=1) <= reach_m
    return points_m[kept]


def _beams(
    points_m: FloatArray, kept: float | str, recording: Recording, rng: np.random.Generator
) -> FloatArray:
    own_deg = recording.sensor.beams_deg
    if isinstance(kept, str):
        return _as_sensor(points_m, sensor_named(kept), recording.sensor, rng)
    return _near_beams(
        points_m, np.linspace(own_deg[0], own_deg[-1], min(int(kept), len(own_deg))), own_deg
    )


def _as_sensor(
    points_m: FloatArray, sensor: Sensor, own: Sensor, rng: np.random.Generator
) -> FloatArray:
    """Return the returns that another sensor would have had too; none is added.

    One whose pattern does not repeat keeps a share at random: that of its own rays and of those
    that recorded the scan, in the part of its field of view that both have.
    """
    if sensor.fov_deg < 360.0:
        points_m = points_m[_within_deg(points_m, 0.0, sensor.fov_deg)]
    kept_deg, own_deg = sensor.beams_deg, own.beams_deg
    if sensor.repeats:
        return _near_beams(points_m, kept_deg, own_deg)
    lowest_deg, highest_deg = kept_deg[0], kept_deg[-1]
    elevation_deg = _elevation_deg(points_m)
    points_m = points_m[(elevation_deg >= lowest_deg) & (elevation_deg <= highest_deg)]
    both_deg = max(0.0, min(highest_deg, own_deg[-1]) - max(lowest_deg, own_deg[0]))
    in_both = np.count_nonzero((own_deg >= lowest_deg) & (own_deg <= highest_deg))
    wanted = sensor.rays_per_scan / sensor.fov_deg * both_deg / (highest_deg - lowest_deg)
    recorded = in_both * own.azimuths / 360.0  # of one degree of azimuth, as are those wanted
    if wanted >= recorded:
        return points_m
    kept: BoolArray = rng.random(len(points_m)) < wanted / recorded
    return points_m[kept]


def _near_beams(points_m: FloatArray, kept_deg: FloatArray, own_deg: FloatArray) -> FloatArray:
    """Return the returns within half a step of the recording sensor from one of the beams."""
    half_step_deg = float(np.median(np.diff(own_deg))) / 2.0
    elevation_deg = _elevation_deg(points_m)
    above = np.searchsorted(kept_deg, elevation_deg).clip(1, len(kept_deg) - 1)
    off_deg = np.minimum(
        np.abs(elevation_deg - kept_deg[above - 1]), np.abs(elevation_deg - kept_deg[above])
    )
    near: BoolArray = off_deg <= half_step_deg
    return points_m[near]


def _elevation_deg(points_m: FloatArray) -> FloatArray:
    return np.degrees(np.arctan2(points_m[:, 2], np.hypot(*points_m[:, :2].T)))


def _drop(points_m: FloatArray, share: float, _: Recording, rng: np.random.Generator) -> FloatArray:
    kept: BoolArray = rng.random(len(points_m)) >= share
    return points_m[kept]


def _snow(points_m: FloatArray, share: float, _: Recording, rng: np.random.Generator) -> FloatArray:
    flake_m = rng.gamma(SNOW_SHAPE, SNOW_SCALE_M, len(points_m)) + SNOW_LEAST_M
    flake_m[rng.random(len(points_m)) >= share] = np.inf
    share_of_way = np.minimum(1.0, flake_m / np.linalg.norm(points_m, axis=1))
    return np.asarray(points_m * share_of_way[:, None])


def _skew(
    points_m: FloatArray, speed_m_s: float, _: Recording, _rng: np.random.Generator
) -> FloatArray:
    # The scan's pose is that of the middle of the turn, when the sensor looks ahead.
    at_s = TURN_S * _azimuth_deg(points_m) / 360.0
    moved_m = points_m.copy()
    moved_m[:, 0] -= speed_m_s * at_s
    yaw = np.radians(SKEW_YAW_RATE_DEG_S * at_s)
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = moved_m[:, 0].copy(), moved_m[:, 1].copy()
    moved_m[:, 0], moved_m[:, 1] = cos * x + sin * y, cos * y - sin * x
    return moved_m


@dataclass(frozen=True)
class _Kind:
    """One kind of disturbance.

    Attributes:
        wanted: What its value is, with the unit and the range.
        lowest, highest: Between which the value is.
        apply: Does it: returns, value, recording, random numbers.
        is_whole: Whether the value is a whole number.
        is_of_sensor: Whether it is by angles or distances from the sensor, not from its vehicle.
    """

    wanted: str
    lowest: float
    highest: float
    apply: Callable[..., FloatArray]
    is_whole: bool = False
    is_of_sensor: bool = False


DISTURBANCES: Mapping[str, _Kind] = {
    "hidden": _Kind("0 to 360 degrees", 0.0, 360.0, _hidden),
    "fov": _Kind("0 to 360 degrees", 0.0, 360.0, _fov, is_of_sensor=True),
    "truck": _Kind("1 or 2", 1.0, 2.0, _truck, is_whole=True),
    "pitch": _Kind("0 to 45 degrees", 0.0, 45.0, partial(_tilted, axis="y")),
    "roll": _Kind("0 to 45 degrees", 0.0, 45.0, partial(_tilted, axis="x")),
    "height": _Kind("-10 to 10 metres", -10.0, 10.0, _height),
    "reach": _Kind("0.1 to 1000 metres", 0.1, 1000.0, _reach, is_of_sensor=True),
    "beams": _Kind(
        f"2 to 1024 beams or one of {', '.join(sorted(SENSORS))}",
        2.0,
        1024.0,
        _beams,
        is_whole=True,
        is_of_sensor=True,
    ),
    "drop": _Kind("a share, 0 to 1", 0.0, 1.0, _drop),
    "snow": _Kind("a share, 0 to 1", 0.0, 1.0, _snow, is_of_sensor=True),
    "skew": _Kind("0 to 100 metres a second", 0.0, 100.0, _skew),
}
"""Every kind of disturbance by its name; docs/how-to/evaluate-a-drive.md says what each does."""
