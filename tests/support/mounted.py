"""A simulated drive past the places of `recording`, by a sensor that is mounted askew."""

import functools

import numpy as np
from scipy.spatial.transform import Rotation

from core.arrays import FloatArray
from core.scans.angles import wrapped_deg
from core.scans.drive import MemoryDrive
from core.scans.mounting import Mounting
from core.scans.pose import Pose
from core.scans.scan import Scan
from core.scans.tilt import Tilt
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor, cast

ASKEW = Mounting(1.1, -0.4, 1.9, 3.0, -6.0, 120.0)


@functools.cache
def vehicle_poses(scans: int = 48) -> FloatArray:
    """Return the vehicle's pose rows, on the ground."""
    rows = _city().poses[:scans].copy()
    rows[:, 2] = 0.0
    return rows


@functools.cache
def mounted_recording(
    mounting: Mounting = ASKEW, *, scans: int = 48, name: str = "askew", sparse: bool = False
) -> MemoryDrive:
    """Return the drive as the sensor records it, with the sensor's poses.

    Args:
        mounting: Of the sensor.
        scans: How many.
        name: Of the drive.
        sparse: Whether each scan has a fifth of the returns in a quarter of the revolution, another
            one each time.
    """
    city = _city()
    rows = mounting.sensor_poses(vehicle_poses(scans))
    heading = Rotation.from_euler("z", mounting.yaw_deg, degrees=True)
    tilt = Rotation.from_euler("xy", [mounting.roll_deg, mounting.pitch_deg], degrees=True)
    recorded = []
    for index, (row, vehicle) in enumerate(zip(rows, vehicle_poses(scans), strict=True)):
        # The simulator's sensor is upright; a tilted one has the same returns in other axes.
        upright = Rotation.from_quat(vehicle[3:]) * heading
        time_s = float(city.timestamp_s[index])
        rng = np.random.default_rng([11, index])
        scan = cast(
            city.world.at(time_s, around_m=(vehicle[0], vehicle[1]), give_way_m=1.5),
            Pose(*row[:3].tolist(), *upright.as_quat().tolist()),
            city.sensor,
            rng,
            timestamp_s=time_s,
        )
        points_m = tilt.inv().apply(scan.points_m.astype(np.float64))
        if sparse:
            azimuth_deg = np.degrees(np.arctan2(points_m[:, 1], points_m[:, 0]))
            seen = np.abs(wrapped_deg(azimuth_deg - 137.0 * index)) < 45.0
            points_m = points_m[seen & (rng.random(len(points_m)) < 0.2)]
        recorded.append(Scan.from_returns(points_m, timestamp_s=time_s, pose=Pose(*row.tolist())))
    return MemoryDrive(name, recorded)


def tilted(
    scan: Scan, tilt: Tilt, mounting: Mounting = ASKEW, above_ground_m: float = 1.73
) -> Scan:
    """Return a scan, less the ground, as its mounted sensor has it while the vehicle is tilted."""
    vehicle_m = mounting.mount(scan, above_ground_m).points_m.astype(np.float64)
    vehicle_m = vehicle_m[vehicle_m[:, 2] > 1.0 - above_ground_m]
    turn = Rotation.from_euler("xy", [tilt.roll_deg, tilt.pitch_deg], degrees=True)
    tilted_m = turn.inv().apply(vehicle_m)
    tilted_m -= np.array([mounting.x_m, mounting.y_m, mounting.z_m - above_ground_m])
    angles_deg = (mounting.roll_deg, mounting.pitch_deg, mounting.yaw_deg)
    return Scan.from_returns(
        Rotation.from_euler("xyz", angles_deg, degrees=True).inv().apply(tilted_m)
    )


@functools.cache
def _city() -> SimulatedDrive:
    return SimulatedDrive(
        seed=1, scans=48, stops=False, noise_seed=11, sensor=SimulatedSensor(firings=180)
    )
