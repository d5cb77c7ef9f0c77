"""Whether z is up in the scans of a drive: on which side of the sensor the ground is."""

import math
from dataclasses import dataclass

import numpy as np

from core.arrays import Float32Array
from core.errors import TensorMapError
from core.projection.ground import ground_planes
from core.scans.drive import Drive
from core.scans.sampling import spread_evenly

_SCANS, _LEAST_SCANS = 10, 3
_LEAST_SHARE = 0.5  # of these scans
_HEIGHTS = (1.0, 0.5, 2.0)  # of the map's: a robot's sensor, or a lorry's, with a car's default
# A sensor that only looks up sees a ceiling as an upside-down one sees the ground, but nothing on
# the other side of it.
_OTHER_SIDE_M, _LEAST_OTHER_SIDE = 0.1, 0.005
# The highest returns of a sensor that hardly looks up are on a cone, which is nearly a plane.
_STEEP, _LEAST_STEEP = math.tan(math.radians(5.0)), 0.01
_MOST_POINTS = 20_000  # of one scan: the ground is as well seen in these


@dataclass(frozen=True)
class UpAxis:
    """An axis of a sensor that points up, where z should.

    Attributes:
        axis: `-z`, `+y`, `-y`, `+x` or `-x`.
        scans: Number of the scans that show it.
        of_scans: Number of the scans that were looked at.
    """

    axis: str
    scans: int
    of_scans: int

    @property
    def angle_deg(self) -> tuple[str, float]:
        """The angle of a mounting that turns the axis up, `roll_deg` or `pitch_deg`."""
        return _ANGLES[self.axis]


# By axis: what is x, y and z then, as columns and signs.
_TURNS: dict[str, tuple[tuple[int, int, int], tuple[int, int, int]]] = {
    "-z": ((0, 1, 2), (1, -1, -1)),
    "+y": ((0, 2, 1), (1, -1, 1)),
    "-y": ((0, 2, 1), (1, 1, -1)),
    "+x": ((2, 1, 0), (-1, 1, 1)),
    "-x": ((2, 1, 0), (1, 1, -1)),
}
_ANGLES = {
    "-z": ("roll_deg", 180.0),
    "+y": ("roll_deg", 90.0),
    "-y": ("roll_deg", -90.0),
    "+x": ("pitch_deg", -90.0),
    "-x": ("pitch_deg", 90.0),
}


def find_other_up_axis(drive: Drive, sensor_height_m: float) -> UpAxis | None:
    """Return the axis that points up in a drive, `None` if that is z or not known.

    Some scans are looked at, one only if it shows the ground below the sensor. Where none does, a
    ground plane across another axis in half of them is the ground.

    Args:
        drive: The drive as a map is built of it.
        sensor_height_m: The map's sensor height; half and twice of it are tried too.
    """
    seen: list[Float32Array] = []
    for at in spread_evenly(np.arange(len(drive)), _SCANS).tolist():
        try:
            points_m = drive.scan(at).points_m
        except TensorMapError:  # is reported where it is needed
            continue
        if _has_ground(points_m, sensor_height_m):
            return None
        seen.append(points_m)
    if len(seen) < _LEAST_SCANS:
        return None
    found = [
        UpAxis(axis, sum(_shows(points_m, axis, sensor_height_m) for points_m in seen), len(seen))
        for axis in _TURNS
    ]
    clear = [one for one in found if one.scans >= _LEAST_SHARE * len(seen)]
    return clear[0] if len(clear) == 1 else None


def find_other_up_axis_of_scan(points_m: Float32Array, *sensor_heights_m: float) -> UpAxis | None:
    """Return the axis that points up in one scan, `None` if that is z or not known.

    As of a drive: there has to be no ground below the sensor, and one across one other axis alone.

    Args:
        points_m: `(n, 3)`, sensor at the origin; some 20,000 of them are looked at.
        sensor_heights_m: The sensor's height, or those that it may have; half and twice of each are
            tried too.
    """
    some_m = np.ascontiguousarray(points_m[:: -(-len(points_m) // _MOST_POINTS) or 1])
    if _has_ground(some_m, *sensor_heights_m):
        return None
    found = [axis for axis in _TURNS if _shows(some_m, axis, *sensor_heights_m)]
    return UpAxis(found[0], 1, 1) if len(found) == 1 else None


def _shows(points_m: Float32Array, axis: str, *sensor_heights_m: float) -> bool:
    columns, signs = _TURNS[axis]
    turned_m = np.ascontiguousarray(points_m[:, columns] * np.array(signs, np.float32))
    x_m, y_m, z_m = turned_m.T
    above = np.count_nonzero(z_m > _OTHER_SIDE_M)
    steep = np.count_nonzero(z_m < -_STEEP * np.hypot(x_m, y_m, dtype=np.float64))
    return bool(
        above >= _LEAST_OTHER_SIDE * len(turned_m)
        and steep >= _LEAST_STEEP * len(turned_m)
        and _has_ground(turned_m, *sensor_heights_m)
    )


def _has_ground(points_m: Float32Array, *sensor_heights_m: float) -> bool:
    planes = ground_planes(points_m, (at * of for at in sensor_heights_m for of in _HEIGHTS))
    return any(plane is not None for plane in planes)
