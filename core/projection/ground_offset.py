"""Whether the ground is where the mounting of a drive's sensor has it."""

from dataclasses import dataclass

import numpy as np

from core.arrays import Float32Array
from core.errors import TensorMapError
from core.projection.ground import GroundPlane, ground_plane
from core.scans.drive import Drive
from core.scans.mounting import Mounting, stated_height_m
from core.scans.sampling import spread_evenly

_SCANS, _LEAST_SCANS = 10, 3
_AS_MOUNTED = 2  # scans that show the ground there: levelling works
_LEAST_SHARE = 0.8  # of the scans show it elsewhere, in one place
_HEIGHTS_M = (1.8, 1.0, 3.0, 0.5, 5.0)  # of a sensor whose height is not known, likely ones first
_ALIKE_M, _ALIKE_DEG = 0.3, 4.0  # of the median: a sensor is fixed to its vehicle
_LEAST_M, _LEAST_DEG = 1.2, 10.0  # of a mounting that is wrong; levelling mends less
_MOST_DEG = 60.0  # another axis is up: `up_axis`


@dataclass(frozen=True)
class GroundOffset:
    """Where the ground is, unlike where the mounting has it.

    Attributes:
        tilt_deg: Angle between the ground and that of the mounting; `None` if as good as none.
        height_m: Sensor height above the ground; `None` if it is nearly that of the mounting.
        scans: Number of the scans that show it.
        of_scans: Number of the scans that were looked at.
    """

    tilt_deg: float | None
    height_m: float | None
    scans: int
    of_scans: int


def find_ground_offset(
    drive: Drive, mounting: Mounting | None, sensor_height_m: float
) -> GroundOffset | None:
    """Return where the ground is if that is far from where the mounting has it, else `None`.

    Some scans are looked at. Two that show the ground where the mounting has it end the search, as
    levelling finds it there. Else it is looked for as if the sensor were level, at any height.

    Args:
        drive: As its sensor recorded it.
        mounting: Its sensor's mounting, `None` if the sensor's frame is the vehicle's.
        sensor_height_m: The map's sensor height.
    """
    seen: list[Float32Array] = []
    as_mounted = 0
    for at in spread_evenly(np.arange(len(drive)), _SCANS).tolist():
        try:
            scan = drive.scan(at)
            mounted = scan if mounting is None else mounting.mount(scan, sensor_height_m)
        except TensorMapError:  # is reported where it is needed
            continue
        as_mounted += ground_plane(mounted.points_m, sensor_height_m) is not None
        if as_mounted == _AS_MOUNTED:
            return None
        seen.append(scan.points_m)
    planes = [plane for points_m in seen if (plane := _ground(points_m)) is not None]
    if len(planes) < max(_LEAST_SCANS, _LEAST_SHARE * len(seen)):
        return None
    normals = np.array([plane.normal for plane in planes])
    depths_m = np.array([plane.depth_m for plane in planes])
    normal, depth_m = np.median(normals, axis=0), float(np.median(depths_m))
    normal /= np.linalg.norm(normal)
    apart_deg = np.degrees(np.arccos(np.clip(normals @ normal, -1.0, 1.0)))
    alike = (apart_deg <= _ALIKE_DEG) & (np.abs(depths_m - depth_m) <= _ALIKE_M)
    if alike.sum() < max(_LEAST_SCANS, _LEAST_SHARE * len(seen)):
        return None
    up = normal if mounting is None else mounting.turned(normal)
    stated_m = stated_height_m(mounting, sensor_height_m)
    tilt_deg = float(np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0))))
    tilted = mounting is not None and tilt_deg >= _LEAST_DEG  # else there is no angle to correct
    elsewhere = abs(depth_m - stated_m) >= _LEAST_M
    if not (tilted or elsewhere) or tilt_deg > _MOST_DEG:
        return None
    return GroundOffset(
        tilt_deg if tilted else None, depth_m if elsewhere else None, int(alike.sum()), len(seen)
    )


def _ground(points_m: Float32Array) -> GroundPlane | None:
    found = (ground_plane(points_m, height_m) for height_m in _HEIGHTS_M)
    return next((plane for plane in found if plane is not None), None)
