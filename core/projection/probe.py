"""Probes: disturbed scans of the map, as of another vehicle on another day, that calibrate it."""

import numpy as np

from core.arrays import BoolArray, FloatArray
from core.errors import InvalidScan
from core.projection.imager import Image, Imager, Views
from core.scans.angles import wrapped_deg
from core.scans.displacement import seen_from_beside
from core.scans.scan import Scan

Displacement = tuple[float, float, float]
"""How far a probe is ahead and to the left of its scan, metres, and its relative yaw, degrees."""

LEFT_OUT_M = 1.0
"""Scans recorded so near to a probe's scan are not searched: no vehicle is exactly there."""

PROBES = 200
"""How many scans of a drive are probed at most, evenly spread."""

_DISPLACED, _DISTURBED = 20_001, 20_002  # seeds, together with a scan's position in its drive
_NOISE_M, _ALONE_NOISE_M = 0.5, 0.05
_CARS = 4  # that hide something, at most
_CAR_AHEAD_M = (3.0, 12.0)  # horizontal distance of its near side
_CAR_ACROSS_M = (1.8, 4.5)  # from behind, from the side
_CAR_TOP_M = 1.5  # above the ground
_PARTIAL = 0.5  # of the probes of a map of any views
_HIDDEN_DEG = (30.0, 240.0)
_ALONE_M = 0.5  # how far beside the line, in a map without renderings
_PAST_M = 0.5  # beyond the outermost rendering
_TOWARDS = (0.25, 1.0)  # how much of the way to the next scan that is searched
_FARTHEST_M = 6.0  # that a scan can be moved and still be realistic
_PAPER_TURN_DEG = 2.0  # standard deviation: the paper's encoding answers who drives as was mapped


def probe_image(
    scan: Scan, position: int, imager: Imager, displacement: Displacement
) -> Image | None:
    """Return the image of a scan's probe, `None` if nothing of it is left in the grid."""
    try:
        return imager.image(probe_scan(scan, position, imager, displacement))
    except InvalidScan:
        return None


def probe_scan(scan: Scan, position: int, imager: Imager, displacement: Displacement) -> Scan:
    """Disturb a scan, always in the same way for the same position.

    Up to four cars hide what is behind them, the vehicle is displaced, and returns have noise of
    up to 0.5 m (5 cm in a map without renderings). In a map of any views half of the probes lose a
    sector.

    Args:
        scan: The scan as recorded.
        position: The scan's position in its drive; with a fixed seed it determines all random
            numbers.
        imager: The map's imager.
        displacement: The displacement that `displacement_of_probe` returns.

    Raises:
        InvalidScan: If no return is left that is finite.
    """
    rng = np.random.default_rng([_DISTURBED, position])
    points = scan.points_m.astype(np.float64)
    for _ in range(int(rng.integers(0, _CARS, endpoint=True))):
        _occlude_by_a_car(points, imager.sensor_height_m, rng)
    ahead_m, left_m, turn_deg = displacement
    points = seen_from_beside(points, left_m, turn_deg, ahead_m)
    most_m = _ALONE_NOISE_M if imager.lateral_renderings_m is None else _NOISE_M
    points += rng.normal(scale=rng.uniform(0.0, most_m), size=points.shape)
    if imager.views == Views.ANY and rng.random() < _PARTIAL:
        azimuth_deg = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
        off_deg = np.abs(wrapped_deg(azimuth_deg - rng.uniform(-180.0, 180.0)))
        points = points[off_deg > rng.uniform(*_HIDDEN_DEG) / 2.0]
    return Scan.from_returns(points)


def displacement_of_probe(
    position: int, imager: Imager, poses: FloatArray, row: int
) -> Displacement:
    """Return the displacement of a probe: beside its scan and on the way to a neighbouring one.

    To the side as far as the map's renderings reach and half a metre more, in any heading. A map
    without renderings (the paper's) answers vehicles that drive as was mapped: there the offset is
    up to 0.5 m and the heading is off by 2 degrees (standard deviation).

    Along the path, towards the scan before or after it that is beyond `LEFT_OUT_M`: without its own
    scan, an undisplaced probe would be a whole step from the next one, and a vehicle is half a step
    from one at most.

    Args:
        position: The scan's position in its drive; it determines all random numbers.
        imager: The map's imager.
        poses: `(n, 7)` of the drive's scans that are projected, NaN where unknown.
        row: The row of the probe's scan among them.
    """
    rng = np.random.default_rng([_DISPLACED, position])
    offsets = imager.lateral_renderings_m
    if offsets is None:
        left_m, turn_deg = rng.uniform(-_ALONE_M, _ALONE_M), rng.normal(scale=_PAPER_TURN_DEG)
    else:
        left_m = rng.uniform(offsets[0] - _PAST_M, offsets[-1] + _PAST_M)
        turn_deg = rng.uniform(-180.0, 180.0)
    onward_m = rng.uniform(*_TOWARDS) * _way_to_neighbour_m(poses, row, rng)
    return float(onward_m[0]), float(left_m + onward_m[1]), float(turn_deg)


def _way_to_neighbour_m(poses: FloatArray, row: int, rng: np.random.Generator) -> FloatArray:
    """Return the way to a neighbouring scan, ahead and to the left, 0 where none is known."""
    away_m = np.linalg.norm(poses[:, :3] - poses[row, :3], axis=1)
    beyond: BoolArray = away_m > LEFT_OUT_M  # not where a pose is unknown
    rows = np.flatnonzero(beyond)
    before, after = rows[rows < row][-1:], rows[rows > row][:1]
    neighbours = np.concatenate([before, after])
    if not len(neighbours):
        return np.zeros(2)
    neighbour = neighbours[rng.integers(len(neighbours))]
    way_m = poses[neighbour, :3] - poses[row, :3]
    way_m *= min(1.0, _FARTHEST_M / away_m[neighbour])
    from scipy.spatial.transform import Rotation  # no answer needs it: decision 33

    return np.asarray(Rotation.from_quat(poses[row, 3:]).inv().apply(way_m)[:2])


def _occlude_by_a_car(points: FloatArray, sensor_height_m: float, rng: np.random.Generator) -> None:
    """Move the returns that a car would have occluded forward to its near side, in place."""
    direction = rng.uniform(-np.pi, np.pi)
    ahead_m, across_m = rng.uniform(*_CAR_AHEAD_M), rng.uniform(*_CAR_ACROSS_M)
    x, y, z = points.T
    towards_m = x * np.cos(direction) + y * np.sin(direction)
    aside_m = y * np.cos(direction) - x * np.sin(direction)
    # Most returns are elsewhere and are left out before distances are computed.
    rows = np.flatnonzero(np.abs(aside_m) * ahead_m < towards_m * (across_m / 2.0))
    share = ahead_m / np.hypot(x[rows], y[rows])
    above_ground_m = z[rows] * share + sensor_height_m
    hit = (share < 1.0) & (above_ground_m > 0.0) & (above_ground_m < _CAR_TOP_M)
    points[rows[hit]] *= share[hit, None]
