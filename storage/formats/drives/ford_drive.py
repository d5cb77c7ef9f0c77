"""Drives in the layout of the Ford Campus data set: `SCANS/Scan*.mat`.

Pandey, McBride and Eustice, "Ford Campus vision and lidar data set", IJRR 30 (2011). Each file has
a struct `SCAN` with `XYZ` (3 x N metres in the laser's frame), `X_wv` (the vehicle's pose in a
local world) and `timestamp_laser` (microseconds since 1970).

Frames. X_ij is the pose of frame j in frame i after Smith, Self and Cheeseman: x, y, z, roll r,
pitch p, heading h, with R_ij = Rz(h) Ry(p) Rx(r), so that p_i = R_ij p_j + t_ij and poses compose
by product. The world is x north, y east, z down; the vehicle x forward, y right, z down. The laser
is mounted at X_vl = (2.4, -0.01, -2.3, pi, 0, pi/2), 2.3 m above the vehicle's origin, with

    R_vl = Rz(pi/2) Rx(pi) = [0 1  0]     laser x is the vehicle's y: right
                             [1 0  0]     laser y is the vehicle's x: forward
                             [0 0 -1]     laser z is up

So the laser's frame is ours except for a rotation about z by 90 degrees: z is up already. The
points keep the laser's frame (the sensor's x axis is the laser's own, in the original recordings to
the right of the truck) and the pose is the laser's, in a world with z up, x north and y west:

    T_world_laser = diag(1, -1, -1, 1) T_wv T_vl

A truck heading north has heading -90 degrees here. Results that depend on relative yaw only are not
affected; virtual viewpoints at the sensor's sides are, for these recordings, ahead and behind,
unless the points are rotated first.

Verified: the numbers of X_vl, the fields and the order of the rotations, in independent public code
for this data set; that code also takes laser y as forward and z as up. Not verified for lack of an
original recording: that X_wv is z-down, as in the authors' convention, and `PARAM.mat`.
"""

import math
from contextlib import suppress
from functools import cached_property
from pathlib import Path

import numpy as np

from core.arrays import FloatArray, frozen
from core.errors import EmptyDrive, InvalidPose, InvalidScan
from core.scans.pose import Pose, pose_rows
from core.scans.scan import Scan
from core.scans.times import flaw_of_time
from storage.formats.drives.file_drive import in_order
from storage.formats.drives.z_down import Z_DOWN_TO_Z_UP, matrices_of
from storage.formats.errors import MalformedScan
from storage.formats.scans.ford import points_m_of, scan_matrices

_LASER_ON_VEHICLE = np.array([2.4, -0.01, -2.3, math.pi, 0.0, math.pi / 2])
_FACT_SIZES = {"timestamp_laser": 1, "X_wv": 6}


class FordDrive:
    """A drive of `Scan*.mat` files.

    Timestamps and poses are inside the files: their first use reads every file once.

    Attributes:
        name: A short name.
        files: The scan files in order.
    """

    def __init__(self, name: str, files: tuple[Path, ...], *, min_returns: int = 1) -> None:
        if not files:
            raise EmptyDrive(f"drive {name!r} has no files Scan*.mat")
        self.name = name
        self.files = files
        self._min_returns = min_returns

    def __len__(self) -> int:
        return len(self.files)

    @property
    def timestamp_s(self) -> FloatArray:
        """`(K,)` seconds since 1970, NaN where unknown."""
        return self._facts[0]

    @property
    def poses(self) -> FloatArray:
        """`(K, 7)` pose rows of the laser, NaN where unknown."""
        return self._facts[1]

    def scan(self, index: int) -> Scan:
        """Read scan `index`, 0-based.

        Raises:
            InvalidScan: If the file cannot be used; a subclass says why.
        """
        return read_ford_scan(self.files[index], min_returns=self._min_returns)

    @cached_property
    def _facts(self) -> tuple[FloatArray, FloatArray]:
        timestamp_s = np.full(len(self), np.nan)
        poses: list[Pose | None] = [None] * len(self)
        for index, file in enumerate(self.files):
            # What is damaged raises when its scan is read; the rest of the drive is usable.
            with suppress(InvalidScan):
                scan = read_ford_scan(file, min_returns=0)
                timestamp_s[index], poses[index] = scan.timestamp_s, scan.pose
        return frozen(timestamp_s, np.float64), frozen(pose_rows(poses), np.float64)


def open_ford_drive(path: Path, *, min_returns: int = 1) -> FordDrive:
    """Open a drive of `SCANS/Scan*.mat`, in the order of their numbers.

    Raises:
        EmptyDrive: If there are no scans.
    """
    files = in_order((path / "SCANS").glob("Scan*.mat"))
    return FordDrive(path.resolve().name, files, min_returns=min_returns)


def read_ford_scan(path: Path, *, min_returns: int = 1) -> Scan:
    """Read one `Scan*.mat`, with its time and pose; errors name the file.

    Raises:
        InvalidScan: If the file has no `SCAN.XYZ` of shape (3, N), a pose or time of another size,
            or one that is none; a subclass says why.
        TooFewReturns: If fewer than `min_returns` are left.
    """
    try:
        matrices = scan_matrices(path.read_bytes(), {"XYZ", *_FACT_SIZES})
        facts = {}
        for field, size in _FACT_SIZES.items():
            values = matrices.get(field, np.full(size, np.nan)).astype(np.float64).reshape(-1)
            if len(values) != size:
                raise MalformedScan(f"SCAN.{field} has {len(values)} values, wanted {size}")
            facts[field] = values
        timestamp_s = float(facts["timestamp_laser"][0]) / 1e6
        flaw = None if math.isnan(timestamp_s) else flaw_of_time(timestamp_s)
        if flaw is not None:
            raise MalformedScan(f"the time of SCAN.timestamp_laser is {flaw}")
        return Scan.from_returns(
            points_m_of(matrices),
            min_returns=min_returns,
            timestamp_s=timestamp_s,
            pose=_laser_pose(facts["X_wv"]),
        )
    except InvalidScan as error:
        raise type(error)(f"{path.name}: {error}") from error


def _laser_pose(vehicle_pose: FloatArray) -> Pose | None:
    if not np.isfinite(vehicle_pose).all():
        return None
    of_vehicle, on_vehicle = matrices_of(np.stack([vehicle_pose, _LASER_ON_VEHICLE]))
    matrix = Z_DOWN_TO_Z_UP @ of_vehicle @ on_vehicle
    try:
        return Pose.from_matrix(matrix)
    except InvalidPose as error:
        raise MalformedScan(f"SCAN.X_wv: {error}") from error
