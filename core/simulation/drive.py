"""A drive through a simulated city, its scans cast when they are read."""

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from core.arrays import FloatArray, frozen
from core.errors import InvalidParameters
from core.numbers import require_above, require_at_least
from core.scans.pose import Pose
from core.scans.scan import Scan
from core.simulation.city import City
from core.simulation.raycast import SimulatedSensor, cast
from core.simulation.route import Route
from core.simulation.world import World

_SCAN_S = 0.1  # the HDL-64E turns ten times a second
_BLOCK_M = 69.0  # the usual side of a block, see the city
TURN_RADIUS_M = 12.0
"""Of the line at a corner: no vehicle is as far to its left or right."""
_TURN_PACE = 0.45  # of the speed on a straight: a vehicle slows for a corner
_LOOP_SHARE = 0.75  # of what the drive would cover unhindered; turns and stops cost the rest
_STOP_BEFORE_TURN_M = 4.0
_STOP_SCANS = (8, 20)
_GIVE_WAY_M = 1.5  # from the sensor to a moving car's side: the vehicle is 1.8 m wide
_STOPS, _NOISE = range(2)  # streams of random numbers


class SimulatedDrive:
    """A recorded loop through a city of `seed`, at ten scans a second; a `Drive`.

    The vehicle follows the streets' centre line, slower in turns, stops before every second turn,
    and with enough scans passes the street it began in again. It starts and stops at once and a
    revolution of the sensor takes no time: there is no acceleration and no motion distortion.
    Scan `i` is the same whenever and however often it is read.

    Two drives of one `seed`, `scans`, `speed_m_s` and `loop_m` follow one line in one world frame.
    Vary `traffic_seed`, `lateral_offset_m`, `reverse` and `noise_seed` for the same streets on
    another day, from another lane, in the other direction.

    Args:
        seed: The city's seed.
        scans: How many.
        speed_m_s: The speed on straights; a tenth of it lies between two scans.
        lateral_offset_m: How far left of the line the vehicle truly drives, as it is heading;
            negative right. Up to 3 m it clears what is parked.
        reverse: Drive the same places in the opposite order and direction.
        stops: Stop before turns.
        traffic_seed: The seed of parked and moving cars; `seed` by default.
        noise_seed: The seed of range noise and dropouts; `traffic_seed` by default.
        loop_m: About how long the loop is; by default such that the drive closes it. A loop is at
            least one block; a longer drive repeats it.
        sensor: The sensor that records.
        sensor_height_m: Above the ground; 1.73 m is KITTI's HDL-64E.

    Raises:
        InvalidParameters: If there is no scan or a parameter is out of its range.

    Examples:
        >>> drive = SimulatedDrive(seed=1, scans=20)
        >>> len(drive), drive.poses.shape, drive.timestamp_s[:3].round(6).tolist()
        (20, (20, 7), [0.0, 0.1, 0.2])
        >>> again = SimulatedDrive(seed=1, scans=20)
        >>> bool((drive.scan(7).points_m == again.scan(7).points_m).all())
        True
    """

    def __init__(
        self,
        seed: int = 0,
        scans: int = 300,
        *,
        speed_m_s: float = 15.0,
        lateral_offset_m: float = 0.0,
        reverse: bool = False,
        stops: bool = True,
        traffic_seed: int | None = None,
        noise_seed: int | None = None,
        loop_m: float | None = None,
        sensor: SimulatedSensor | None = None,
        sensor_height_m: float = 1.73,
    ) -> None:
        traffic_seed = seed if traffic_seed is None else traffic_seed
        self._noise_seed = traffic_seed if noise_seed is None else noise_seed
        if loop_m is None:
            loop_m = _LOOP_SHARE * scans * speed_m_s * _SCAN_S
        require_at_least(1, scans=scans)
        require_at_least(0, noise_seed=self._noise_seed)
        require_above(0, speed_m_s=speed_m_s, sensor_height_m=sensor_height_m, loop_m=loop_m)
        if not abs(lateral_offset_m) < TURN_RADIUS_M:
            raise InvalidParameters(
                f"lateral_offset_m is {lateral_offset_m}, wanted within the turn radius,"
                f" {TURN_RADIUS_M} m"
            )
        east, north = _loop_blocks(loop_m)
        self.name = f"simulated-{seed}"
        self.sensor = SimulatedSensor() if sensor is None else sensor
        # One block of houses all around the loop, for the far side of its streets.
        self._city = City(seed, traffic_seed, (east + 2, north + 2))
        self.route = Route.around(
            _loop_corners(self._city, east, north), turn_radius_m=TURN_RADIUS_M
        )
        stops_rng = np.random.default_rng([seed, _STOPS]) if stops else None
        along_m = _distances(self.route, scans, speed_m_s * _SCAN_S, stops_rng)
        self.along_m: FloatArray = frozen(along_m[::-1] if reverse else along_m, np.float64)
        self.timestamp_s: FloatArray = frozen(np.arange(scans) * _SCAN_S, np.float64)
        rows = _pose_rows(
            self.route, self.along_m, lateral_offset_m, sensor_height_m, reverse=reverse
        )
        self.poses: FloatArray = frozen(rows, np.float64)

    @cached_property
    def world(self) -> World:
        """All of the city; scans need only what is around them."""
        return self._city.whole()

    def __len__(self) -> int:
        return len(self.along_m)

    def __iter__(self) -> Iterator[Scan]:
        return (self.scan(index) for index in range(len(self)))

    def scan(self, index: int) -> Scan:
        """Cast scan `index`, 0-based.

        Raises:
            IndexError: If the drive has no such scan.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"scan {index} of a drive of {len(self)}")
        pose = Pose(*self.poses[index].tolist())
        time_s = float(self.timestamp_s[index])
        here_m = pose.x_m, pose.y_m
        # The whole city grows with the square of the loop.
        world = self._city.around(*here_m, self.sensor.max_range_m)
        scene = world.at(time_s, around_m=here_m, give_way_m=_GIVE_WAY_M)
        rng = np.random.default_rng([self._noise_seed, _NOISE, index])
        return cast(scene, pose, self.sensor, rng, timestamp_s=time_s)


def _loop_blocks(loop_m: float) -> tuple[int, int]:
    """Return how many blocks east and north a loop of about `loop_m` encloses."""
    half_round = max(2, int(loop_m / (2.0 * _BLOCK_M)))
    return half_round // 2, half_round - half_round // 2


def _loop_corners(city: City, east: int, north: int) -> list[tuple[float, float]]:
    """Return the loop's corners, one block inside the city.

    A loop at least two blocks wide and high has a corner cut out, so that it turns left and right.
    """
    corners = [(1, 1), (1 + east, 1)]
    if min(east, north) >= 2:
        cut_east, cut_north = 1 + east - east // 2, 1 + north - north // 2
        corners += [(1 + east, cut_north), (cut_east, cut_north), (cut_east, 1 + north)]
    else:
        corners += [(1 + east, 1 + north)]
    corners += [(1, 1 + north)]
    x_m, y_m = city.street_x_m, city.street_y_m
    return [(x_m[i], y_m[j]) for i, j in corners]


def _distances(
    route: Route, scans: int, spacing_m: float, rng: np.random.Generator | None
) -> FloatArray:
    """Return how far along the route each scan is, `(scans,)` metres; no stops without `rng`."""
    stop_m = (route.arc_starts_m[::2] - _STOP_BEFORE_TURN_M) % route.length_m
    along_m = np.empty(scans)
    now_m, standing = 0.0, 0
    for index in range(scans):
        along_m[index] = now_m
        if standing > 0:
            standing -= 1
            continue
        next_m = now_m + spacing_m * (_TURN_PACE if route.on_arc(now_m) else 1.0)
        to_stop_m = (stop_m - now_m) % route.length_m
        if rng is not None and (to_stop_m < next_m - now_m).any():
            standing = int(rng.integers(*_STOP_SCANS, endpoint=True))
        now_m = next_m
    return along_m


def _pose_rows(
    route: Route, along_m: FloatArray, offset_m: float, height_m: float, *, reverse: bool
) -> FloatArray:
    x, y, heading_deg = route.at(along_m)
    heading = np.radians(heading_deg + (180.0 if reverse else 0.0))
    rows = np.zeros((len(along_m), 7))
    rows[:, 0] = x - offset_m * np.sin(heading)
    rows[:, 1] = y + offset_m * np.cos(heading)
    rows[:, 2] = height_m
    rows[:, 5], rows[:, 6] = np.sin(heading / 2.0), np.cos(heading / 2.0)
    return rows
