"""The mounting of a sensor on its vehicle, and scans and drives in the vehicle's frame.

The vehicle's frame is x forward, y left, z up, its origin on the ground below the vehicle's
reference point, for example the middle of the rear axle. Poses of recorded scans are the sensor's;
those of a mounted drive, and answers to mounted queries, are the vehicle's.
"""

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from core.arrays import FloatArray, IntArray, frozen
from core.errors import InvalidParameters
from core.numbers import numbers_of
from core.scans.accumulation import AccumulatedDrive
from core.scans.drive import Drive, scan_index_of
from core.scans.pose import Pose, is_known, pose_rows
from core.scans.scan import Scan

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

FARTHEST_M = 50.0
"""Farthest sensor from the vehicle's origin, ahead or to the side."""
HIGHEST_M = 100.0
"""Bound of a sensor's height above the ground, which is below it, as of `sensor_height_m`."""
_WANTED = (
    "x,y,z,roll,pitch,yaw of the sensor in the vehicle's frame, metres and degrees, or x,y,z of one"
    " that is not turned"
)


@dataclass(frozen=True)
class Mounting:
    """Position and orientation of a sensor in the vehicle's frame.

    The sensor's axes are the vehicle's, rotated by the roll about x, then by the pitch about y,
    then by the yaw about z, each about the vehicle's axis: R = Rz(yaw) Ry(pitch) Rx(roll). With a
    positive pitch the sensor looks down, with a positive yaw to the left.

    Attributes:
        x_m: How far the sensor is ahead of the vehicle's origin.
        y_m: How far to its left.
        z_m: Height above the ground.
        roll_deg: Rotation about x, right side down.
        pitch_deg: Rotation about y, front down.
        yaw_deg: Rotation about z, counter-clockwise.

    Examples:
        A sensor on the left side looks to the left: what is ahead of it is to the vehicle's left.

        >>> mounting = Mounting(1.0, 0.5, 2.0, yaw_deg=90.0)
        >>> seen = Scan.from_returns([[10.0, 0.0, -2.0]])
        >>> mounting.mount(seen, above_ground_m=2.0).points_m.round(3).tolist()
        [[1.0, 10.5, -2.0]]
    """

    x_m: float
    y_m: float
    z_m: float
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            # 2 and 2.0, or 0.0 and -0.0, are one mounting.
            value = float(getattr(self, field.name)) + 0.0
            object.__setattr__(self, field.name, value)
            most = FARTHEST_M if field.name in {"x_m", "y_m"} else 360.0
            if field.name != "z_m" and not -most <= value <= most:
                raise InvalidParameters(f"{field.name} is {value}, wanted -{most:g} to {most:g}")
        if not 0.0 < self.z_m < HIGHEST_M:
            raise InvalidParameters(
                f"z_m is {self.z_m}, wanted the height of the sensor above ground, above 0 and"
                f" below {HIGHEST_M:g}"
            )

    @classmethod
    def from_text(cls, text: str) -> "Mounting":
        """Read `x,y,z,roll,pitch,yaw`, or `x,y,z` of a sensor that is not turned.

        Raises:
            InvalidParameters: If it is something else, or a number is out of its range.

        Examples:
            >>> Mounting.from_text("1.2,0,1.9,0,5,0").pitch_deg
            5.0
        """
        try:
            numbers = numbers_of(text.split(","))
        except ValueError:
            numbers = []
        if len(numbers) not in {3, 6}:
            raise InvalidParameters(f"mounting is {text[:120]!r}, wanted {_WANTED}")
        return cls(*numbers)

    def __str__(self) -> str:
        return ",".join(repr(getattr(self, field.name)) for field in fields(self))

    def mount(self, scan: Scan, above_ground_m: float) -> Scan:
        """Return a scan of the sensor as one in the vehicle's frame, lifted above the ground.

        Its origin is above the vehicle's, at the height that images of the map assume: heights
        above ground are right whatever the height of the sensor.

        Args:
            scan: The returns in the sensor's frame, with the sensor's pose.
            above_ground_m: Height of the origin of the result; `sensor_height_m` of the map.

        Returns:
            The returns in the vehicle's axes, with the vehicle's pose, which is on the ground.

        Raises:
            TooFewReturns: If no return is left that is finite and away from the origin.
        """
        points_m = self._rotation.apply(scan.points_m.astype(np.float64))
        points_m += np.array([self.x_m, self.y_m, self.z_m - above_ground_m])
        pose = Pose.from_row(self.vehicle_poses(pose_rows([scan.pose]))[0])
        return Scan.from_returns(
            points_m,
            timestamp_s=scan.timestamp_s,
            pose=pose,
            dropped_returns=scan.dropped_returns,
        )

    def seen_by_sensor(
        self, points_m: FloatArray, above_ground_m: float, turned_deg: float = 0.0
    ) -> FloatArray:
        """Return points of mounted scans, `(n, 3)`, as from the sensor: at its place, tilted as it.

        The x axis stays ahead of the vehicle, whichever way the sensor's own looks.

        Args:
            points_m: As `mount` returns them.
            above_ground_m: As for `mount`.
            turned_deg: How far the vehicle was turned to the left since, about its origin, with the
                sensor left as it was.
        """
        rotation, origin_m = self._sensor_frame(above_ground_m, turned_deg)
        return np.asarray(rotation.inv().apply(points_m - origin_m))

    def seen_by_vehicle(
        self, points_m: FloatArray, above_ground_m: float, turned_deg: float = 0.0
    ) -> FloatArray:
        """Return points from the sensor, `(n, 3)` of `seen_by_sensor`, as mounted ones."""
        rotation, origin_m = self._sensor_frame(above_ground_m, turned_deg)
        return np.asarray(rotation.apply(points_m) + origin_m)

    def turned(self, direction: FloatArray) -> FloatArray:
        """Return a direction in the sensor's frame, `(3,)`, in the vehicle's."""
        return np.asarray(self._rotation.apply(direction))

    def vehicle_poses(self, sensor_poses: FloatArray) -> FloatArray:
        """Return the vehicle's `(n, 7)` pose rows of the sensor's; NaN stays NaN."""
        to_sensor = self._rotation.inv()
        return _composed(sensor_poses, -to_sensor.apply(self._position_m), to_sensor)

    def sensor_poses(self, vehicle_poses: FloatArray) -> FloatArray:
        """Return the sensor's `(n, 7)` pose rows of the vehicle's; NaN stays NaN."""
        return _composed(vehicle_poses, self._position_m, self._rotation)

    @property
    def _position_m(self) -> FloatArray:
        return np.array([self.x_m, self.y_m, self.z_m])

    def _sensor_frame(
        self, above_ground_m: float, turned_deg: float
    ) -> tuple["Rotation", FloatArray]:
        """Return rotation and origin of the frame of `seen_by_sensor`."""
        from scipy.spatial.transform import Rotation  # only evaluations need it: decision 33

        turn = Rotation.from_euler("z", -turned_deg, degrees=True)
        rotation = turn * self._rotation
        ahead_x, ahead_y, _ = rotation.inv().apply([1.0, 0.0, 0.0])
        origin_m = turn.apply(self._position_m - [0.0, 0.0, above_ground_m])
        return rotation * Rotation.from_euler("z", np.arctan2(ahead_y, ahead_x)), origin_m

    @property
    def _rotation(self) -> "Rotation":
        from scipy.spatial.transform import Rotation  # only such scans need it: decision 33

        angles_deg = (self.roll_deg, self.pitch_deg, self.yaw_deg)
        return Rotation.from_euler("xyz", angles_deg, degrees=True)


def _composed(rows: FloatArray, position_m: FloatArray, rotation: "Rotation") -> FloatArray:
    """Return the poses of a frame that is at a position, rotated, in the frame of each pose row."""
    composed = np.full(rows.shape, np.nan)
    known = is_known(rows)
    if known.any():
        turned = type(rotation).from_quat(rows[known, 3:])
        composed[known, :3] = rows[known, :3] + turned.apply(position_m)
        composed[known, 3:] = (turned * rotation).as_quat(canonical=True)
    return composed


class MountedDrive:
    """A drive in the vehicle's frame; an `IndexedDrive`.

    Args:
        drive: The drive as its sensor recorded it.
        mounting: The sensor's mounting.
        above_ground_m: Height of the origin of its scans, as in `Mounting.mount`.

    Attributes:
        mounting: As above.
    """

    def __init__(self, drive: Drive, mounting: Mounting, above_ground_m: float) -> None:
        self.name, self.timestamp_s = drive.name, drive.timestamp_s
        self.poses: FloatArray = frozen(mounting.vehicle_poses(drive.poses), np.float64)
        self.scan_index: IntArray = scan_index_of(drive)
        self.mounting = mounting
        self._drive, self._above_ground_m = drive, above_ground_m

    def __len__(self) -> int:
        return len(self._drive)

    def scan(self, index: int) -> Scan:
        """Read scan `index` and mount it.

        Raises:
            InvalidScan: If the recorded scan cannot be used.
        """
        return self.mounting.mount(self._drive.scan(index), self._above_ground_m)


def stated_height_m(mounting: Mounting | None, of_map_m: float) -> float:
    """Return the height above ground that a drive's sensor is said to have.

    Args:
        mounting: The sensor's mounting, which states it; `None` if there is none.
        of_map_m: `sensor_height_m` of the map, which holds without a mounting.
    """
    return of_map_m if mounting is None else mounting.z_m


def vehicle_drive(
    drive: Drive, mounting: Mounting | None, above_ground_m: float, accumulate: int = 1
) -> Drive:
    """Return a recorded drive as a map is built of it.

    Args:
        drive: The drive as its sensor recorded it.
        mounting: The sensor's mounting; `None` if the vehicle's frame is the sensor's.
        above_ground_m: `sensor_height_m` of the map.
        accumulate: How many consecutive scans become one.

    Raises:
        InvalidParameters: If `accumulate` is out of range.
    """
    if accumulate != 1:
        drive = AccumulatedDrive(drive, accumulate)
    return drive if mounting is None else MountedDrive(drive, mounting, above_ground_m)
