"""A probe: a scan of the map as another vehicle, on another day, would have it."""

import numpy as np

from core.arrays import FloatArray, IntArray
from core.displacement import seen_from_beside
from core.errors import InvalidScan
from core.imager import Image, Imager
from core.scan import Scan

__all__ = ["PROBES", "probe_image", "probe_scan", "probed_among", "standing_of_probe"]

PROBES = 200
"""How many scans of a drive are probed at most, evenly spread."""

_STANDING, _DISTURBED = 20_001, 20_002  # seeds, together with a scan's position in its drive
_NOISE_M, _ALONE_NOISE_M = 0.5, 0.05
_CARS = 4  # that hide something, at most
_CAR_AHEAD_M = (3.0, 12.0)  # horizontal distance of its near side
_CAR_ACROSS_M = (1.8, 4.5)  # from behind, from the side
_CAR_TOP_M = 1.5  # above the ground
_ALONE_M = 0.5  # how far beside the line a map without renderings is asked
_PAST_M = 0.5  # beyond the outermost rendering
_PAPER_TURN_DEG = 2.0  # standard deviation: the paper's encoding answers who drives as was mapped


def probed_among(scans: IntArray, at_most: int = PROBES) -> IntArray:
    """Return at most so many of some scans, evenly spread, the first and the last among them.

    Examples:
        >>> probed_among(np.arange(10), 4).tolist()
        [0, 3, 6, 9]
    """
    if len(scans) <= at_most:
        return scans
    return scans[np.linspace(0, len(scans) - 1, at_most).round().astype(np.int64)]


def probe_image(scan: Scan, position: int, imager: Imager) -> Image | None:
    """Return the image of a scan's probe, `None` if nothing of it is left in the grid."""
    try:
        return imager.image(probe_scan(scan, position, imager))
    except InvalidScan:
        return None


def probe_scan(scan: Scan, position: int, imager: Imager) -> Scan:
    """Disturb a scan, always in the same way for the same position.

    Up to four cars hide what is behind them, the vehicle stands where `standing_of_probe` says,
    and returns carry noise of up to 0.5 m (5 cm in a map without renderings).

    Args:
        scan: As recorded.
        position: Of the scan in its drive; with a fixed seed all chance comes from it.
        imager: Of the map.

    Raises:
        InvalidScan: If no return is left that is finite.
    """
    rng = np.random.default_rng([_DISTURBED, position])
    points = scan.points_m.astype(np.float64)
    for _ in range(int(rng.integers(0, _CARS, endpoint=True))):
        points = _behind_a_car(points, imager.sensor_height_m, rng)
    points = seen_from_beside(points, *standing_of_probe(position, imager))
    most_m = _ALONE_NOISE_M if imager.lateral_renderings_m is None else _NOISE_M
    points += rng.normal(scale=rng.uniform(0.0, most_m), size=points.shape)
    return Scan.from_returns(points)


def standing_of_probe(position: int, imager: Imager) -> tuple[float, float]:
    """Return how far to the left of its scan a probe stands, metres, and its turn in degrees.

    As far as the map's renderings reach and half a metre more, in any heading. A map without
    renderings (the paper's) promises an answer to who drives as was mapped: there the line is off
    by up to 0.5 m and the heading by 2 degrees (standard deviation).
    """
    rng = np.random.default_rng([_STANDING, position])
    offsets = imager.lateral_renderings_m
    if offsets is None:
        return rng.uniform(-_ALONE_M, _ALONE_M), rng.normal(scale=_PAPER_TURN_DEG)
    return rng.uniform(offsets[0] - _PAST_M, offsets[-1] + _PAST_M), rng.uniform(-180.0, 180.0)


def _behind_a_car(
    points: FloatArray, sensor_height_m: float, rng: np.random.Generator
) -> FloatArray:
    """Bring the returns that a car would have stopped forward to its near side."""
    direction = rng.uniform(-np.pi, np.pi)
    ahead_m, across_m = rng.uniform(*_CAR_AHEAD_M), rng.uniform(*_CAR_ACROSS_M)
    x, y, z = points.T
    far_m = np.hypot(x, y)
    aside = np.abs((np.arctan2(y, x) - direction + np.pi) % (2.0 * np.pi) - np.pi)
    share = ahead_m / np.maximum(far_m, ahead_m)
    above_ground_m = z * share + sensor_height_m
    hit = (
        (far_m > ahead_m)
        & (aside < np.arctan(across_m / 2.0 / ahead_m))
        & (above_ground_m > 0.0)
        & (above_ground_m < _CAR_TOP_M)
    )
    return np.where(hit[:, None], points * share[:, None], points)
