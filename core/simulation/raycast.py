"""From a scene to a scan: a spinning sensor's rays against upright solids."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.errors import InvalidParameters, InvalidPose
from core.numbers import require_above, require_at_least
from core.scans.angles import wrapped_deg
from core.scans.beams import HDL_64E_BEAMS_DEG
from core.scans.pose import Pose
from core.scans.scan import Scan
from core.scans.sensor import Sensor
from core.simulation.world import Boxes, Cylinders, Scene

_LEVEL = 1e-12  # slope given to a beam, or component to a ray, of exactly 0, to divide by it
_UPRIGHT = 1e-6  # how far qx and qy may be from 0


@dataclass(frozen=True)
class SimulatedSensor:
    """A spinning sensor; the defaults are an HDL-64E with about 60,000 returns in a street.

    Attributes:
        beams_deg: Elevation of each beam, in the order of a firing.
        firings: Azimuths of a revolution, evenly spaced.
        range_noise_m: Standard deviation of a range; about the 2 cm of the HDL-64E's datasheet.
        max_range_m: The largest range of any return; 120 m is the HDL-64E's datasheet range.
        ground_range_m: The largest range of returns from the ground; 50 m is the HDL-64E's
            datasheet range on pavement.
        dropout: Share of the returns that are lost at random.
        fov_deg: Horizontal field of view, around the front.
        repeats: Whether each scan has these beams. If not, each has one at random in each of as
            many equal parts between the lowest and the highest.
    """

    beams_deg: tuple[float, ...] = HDL_64E_BEAMS_DEG
    firings: int = 1000
    range_noise_m: float = 0.02
    max_range_m: float = 120.0
    ground_range_m: float = 50.0
    dropout: float = 0.03
    fov_deg: float = 360.0
    repeats: bool = True

    def __post_init__(self) -> None:
        if not self.beams_deg or not all(-90.0 < beam < 90.0 for beam in self.beams_deg):
            raise InvalidParameters("beams_deg wants at least one elevation, each in -90..90")
        require_at_least(1, firings=self.firings)
        require_at_least(0, range_noise_m=self.range_noise_m)
        require_above(0, max_range_m=self.max_range_m, ground_range_m=self.ground_range_m)
        if not 0.0 <= self.dropout < 1.0:
            raise InvalidParameters(f"dropout is {self.dropout}, wanted 0 <= dropout < 1")
        if not 0.0 < self.fov_deg <= 360.0:
            raise InvalidParameters(f"fov_deg is {self.fov_deg}, wanted 0 < fov_deg <= 360")

    @classmethod
    def of(cls, sensor: Sensor) -> "SimulatedSensor":
        """Return a sensor of the catalogue; noise, range and dropout stay those of the HDL-64E."""
        return cls(
            tuple(sensor.beams_deg.tolist()),
            sensor.azimuths,
            fov_deg=sensor.fov_deg,
            repeats=sensor.repeats,
        )

    def in_one_scan(self, rng: np.random.Generator) -> "SimulatedSensor":
        """Return the sensor with the beams of one scan."""
        if self.repeats:
            return self
        edges = np.linspace(min(self.beams_deg), max(self.beams_deg), len(self.beams_deg) + 1)
        beams = edges[:-1] + rng.random(len(self.beams_deg)) * np.diff(edges)
        return replace(self, beams_deg=tuple(beams.tolist()), repeats=True)

    @property
    def azimuth_step_deg(self) -> float:
        """Between two firings."""
        return 360.0 / self.firings

    @cached_property
    def azimuths_deg(self) -> FloatArray:
        """`(firings,)`: clockwise as the HDL-64E turns, from straight behind round to behind."""
        middle = np.arange(self.firings, dtype=np.float64) + 0.5
        return np.asarray(180.0 - self.azimuth_step_deg * middle)

    @cached_property
    def slopes(self) -> FloatArray:
        """`(beams,)`: the tangent of each elevation, never 0."""
        slopes = np.tan(np.radians(np.array(self.beams_deg, dtype=np.float64)))
        return np.asarray(np.where(np.abs(slopes) < _LEVEL, _LEVEL, slopes))


def cast(
    scene: Scene,
    pose: Pose,
    sensor: SimulatedSensor,
    rng: np.random.Generator,
    *,
    timestamp_s: float = math.nan,
) -> Scan:
    """Return what `sensor` at `pose` measures in `scene`.

    The nearest hit of a ray counts: a wall, a roof, the underside of a crown, or the ground at
    z = 0. Returns are in the order of firings, and of beams within one: the `last` reducer depends
    on it. A revolution takes no time: there is no motion distortion. A solid whose footprint
    contains the sensor is not seen, so that the sensor may be under a tree.

    Args:
        scene: The world at one moment.
        pose: Sensor to world; upright, z is the height above the ground.
        sensor: Beams, firings, noise and range.
        rng: The source of noise and dropouts.
        timestamp_s: The scan's time.

    Raises:
        InvalidPose: If the pose is tilted or not above the ground.
        TooFewReturns: If there is no return.

    Examples:
        >>> wall = Scene(Boxes([[10.5, 0.0, 0.0, 1.0, 8.0, 0.0, 5.0]]))
        >>> exact = SimulatedSensor(beams_deg=(0.0,), firings=3, range_noise_m=0.0, dropout=0.0)
        >>> seen = cast(wall, Pose(0.0, 0.0, 1.73), exact, np.random.default_rng(0))
        >>> seen.points_m.round(6).tolist()
        [[10.0, 0.0, 0.0]]
    """
    if max(abs(pose.qx), abs(pose.qy)) > _UPRIGHT or pose.z_m <= 0.0:
        raise InvalidPose(f"the pose is {pose.as_tuple()}, wanted upright above the ground")
    sensor = sensor.in_one_scan(rng)
    across_m = _nearest(scene, pose, sensor)
    slopes = sensor.slopes
    stretch = np.sqrt(1.0 + slopes**2)
    returned = across_m * stretch <= sensor.max_range_m
    returned &= (np.abs(sensor.azimuths_deg) <= sensor.fov_deg / 2.0)[:, None]
    if sensor.dropout:
        # float32: float64 is slower, a byte too coarse.
        returned &= rng.random(across_m.shape, dtype=np.float32) >= sensor.dropout
    firing, beam = np.nonzero(returned)
    across_m = across_m[returned]
    if sensor.range_noise_m:
        noise_m = rng.standard_normal(len(across_m), dtype=np.float32) * sensor.range_noise_m
        across_m += noise_m / stretch[beam]
    azimuth = np.radians(sensor.azimuths_deg)
    points_m = np.empty((len(across_m), 3), dtype=np.float32)
    points_m[:, 0] = across_m * np.cos(azimuth)[firing]
    points_m[:, 1] = across_m * np.sin(azimuth)[firing]
    points_m[:, 2] = across_m * slopes[beam]
    return Scan.from_returns(points_m, timestamp_s=timestamp_s, pose=pose)


class _Crossings(NamedTuple):
    """Where vertical half-planes, one per firing, cut solids: all `(n,)`, distances across."""

    firing: IntArray
    enter_m: FloatArray
    leave_m: FloatArray
    bottom_m: FloatArray
    top_m: FloatArray

    def only(self, which: BoolArray | IntArray) -> "_Crossings":
        return _Crossings(*(column[which] for column in self))  # type: ignore[arg-type]  # of several dtypes


def _nearest(scene: Scene, pose: Pose, sensor: SimulatedSensor) -> FloatArray:
    """Return the distance across the ground to each ray's first hit, `(firings, beams)`, or inf.

    Along a ray a solid is the overlap of two intervals: over its footprint, which all beams of a
    firing share, and between its bottom and its top, which all firings of a beam share.
    """
    slopes = sensor.slopes
    ground_m = np.where(slopes < 0.0, -pose.z_m / slopes, np.inf)
    ground_m[ground_m * np.sqrt(1.0 + slopes**2) > sensor.ground_range_m] = np.inf
    nearest_m = np.broadcast_to(ground_m, (sensor.firings, len(slopes))).copy()
    boxes = _box_crossings(scene.boxes, pose, sensor)
    cylinders = _cylinder_crossings(scene.cylinders, pose, sensor)
    columns = map(np.concatenate, zip(boxes, cylinders, strict=True))
    crossings = _Crossings(*columns)  # type: ignore[arg-type]  # of several dtypes
    crossings = crossings.only(_not_hidden(crossings, pose.z_m, sensor))
    if not len(crossings.firing):
        return nearest_m
    crossings = crossings.only(np.argsort(crossings.firing, kind="stable"))
    bottom_m = (crossings.bottom_m - pose.z_m)[:, None] / slopes
    top_m = (crossings.top_m - pose.z_m)[:, None] / slopes
    hit_m = np.maximum(crossings.enter_m[:, None], np.minimum(bottom_m, top_m))
    leave_m = np.minimum(crossings.leave_m[:, None], np.maximum(bottom_m, top_m))
    hit_m[hit_m > leave_m] = np.inf
    firings, starts = np.unique(crossings.firing, return_index=True)
    first_m = np.minimum.reduceat(hit_m, starts, axis=0)
    nearest_m[firings] = np.minimum(nearest_m[firings], first_m)
    return nearest_m


def _not_hidden(crossings: _Crossings, height_m: float, sensor: SimulatedSensor) -> BoolArray:
    """Return which crossings are not wholly behind a wall that even the highest beam hits."""
    highest_m = height_m + crossings.enter_m * sensor.slopes.max()
    opaque = (crossings.bottom_m <= 0.0) & (crossings.top_m >= np.maximum(highest_m, height_m))
    wall_m = np.full(sensor.firings, sensor.max_range_m)
    np.minimum.at(wall_m, crossings.firing[opaque], crossings.enter_m[opaque])
    return np.asarray(crossings.enter_m <= wall_m[crossings.firing])


def _box_crossings(boxes: Boxes, pose: Pose, sensor: SimulatedSensor) -> _Crossings:
    rows = boxes.rows
    reach_m = sensor.max_range_m + np.hypot(rows[:, 3], rows[:, 4]) / 2.0
    rows = rows[np.hypot(rows[:, 0] - pose.x_m, rows[:, 1] - pose.y_m) < reach_m]
    x, y, yaw_deg, length, width, bottom, top = rows.T
    x, y = x - pose.x_m, y - pose.y_m
    cos, sin = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    # Azimuths of the corners, measured from the centre's: the extremes bound what is covered.
    bearing_deg = np.degrees(np.arctan2(y, x))
    along = length[:, None] / 2.0 * [1, 1, -1, -1]
    across = width[:, None] / 2.0 * [1, -1, 1, -1]
    corner_x = x[:, None] + along * cos[:, None] - across * sin[:, None]
    corner_y = y[:, None] + along * sin[:, None] + across * cos[:, None]
    corner_deg = np.degrees(np.arctan2(corner_y, corner_x))
    aside_deg = wrapped_deg(corner_deg - bearing_deg[:, None])
    solid, firing = _covered(
        bearing_deg - pose.yaw_deg, aside_deg.min(axis=1), aside_deg.max(axis=1), sensor
    )
    # The rays in the box's own frame, where its footprint is a product of two intervals.
    azimuth = np.radians(sensor.azimuths_deg[firing] + pose.yaw_deg - yaw_deg[solid])
    origins = ((x * cos + y * sin)[solid], (y * cos - x * sin)[solid])
    enter_m, leave_m = np.full(len(solid), -np.inf), np.full(len(solid), np.inf)
    for centre, half, ray in zip(
        origins, (length / 2.0, width / 2.0), (np.cos(azimuth), np.sin(azimuth)), strict=True
    ):
        ray = np.where(np.abs(ray) < _LEVEL, _LEVEL, ray)
        one, other = (centre - half[solid]) / ray, (centre + half[solid]) / ray
        enter_m = np.maximum(enter_m, np.minimum(one, other))
        leave_m = np.minimum(leave_m, np.maximum(one, other))
    crossings = _Crossings(firing, enter_m, leave_m, bottom[solid], top[solid])
    return crossings.only((enter_m > 0.0) & (enter_m < leave_m))


def _cylinder_crossings(cylinders: Cylinders, pose: Pose, sensor: SimulatedSensor) -> _Crossings:
    rows = cylinders.rows
    away_m = np.hypot(rows[:, 0] - pose.x_m, rows[:, 1] - pose.y_m)
    seen = (away_m < sensor.max_range_m + rows[:, 2]) & (away_m > rows[:, 2])
    away_m, (x, y, radius, bottom, top) = away_m[seen], rows[seen].T
    bearing_deg = np.degrees(np.arctan2(y - pose.y_m, x - pose.x_m)) - pose.yaw_deg
    aside_deg = np.degrees(np.arcsin(radius / away_m))
    solid, firing = _covered(bearing_deg, -aside_deg, aside_deg, sensor)
    aside = np.radians(sensor.azimuths_deg[firing] - bearing_deg[solid])
    half_chord_m = np.sqrt(
        np.maximum(radius[solid] ** 2 - (away_m[solid] * np.sin(aside)) ** 2, 0.0)
    )
    middle_m = away_m[solid] * np.cos(aside)
    return _Crossings(
        firing, middle_m - half_chord_m, middle_m + half_chord_m, bottom[solid], top[solid]
    )


def _covered(
    bearing_deg: FloatArray, right_deg: FloatArray, left_deg: FloatArray, sensor: SimulatedSensor
) -> tuple[IntArray, IntArray]:
    """Return every pair of a solid and a firing inside the azimuths that the solid covers.

    Args:
        bearing_deg: `(n,)`, of each solid's centre in the sensor's frame.
        right_deg: `(n,)`, its rightmost azimuth less its bearing, at most 0.
        left_deg: `(n,)`, its leftmost azimuth less its bearing, at least 0.
        sensor: The sensor of the firings.
    """
    step_deg = sensor.azimuth_step_deg
    first = np.ceil((180.0 - bearing_deg - left_deg) / step_deg - 0.5).astype(np.int64)
    last = np.floor((180.0 - bearing_deg - right_deg) / step_deg - 0.5).astype(np.int64)
    counts = np.maximum(last - first + 1, 0)
    solid = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(solid)) - np.repeat(np.cumsum(counts) - counts, counts)
    return solid, (first[solid] + within) % sensor.firings
