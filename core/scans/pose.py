"""Poses: sensor to world, `(x, y, z, qx, qy, qz, qw)`, metres and a unit quaternion."""

import hashlib
import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from core.arrays import BoolArray, FloatArray
from core.errors import InvalidPose

UNKNOWN_POSE: tuple[float, ...] = (math.nan,) * 7


_FARTHEST_M = 1e8  # beyond every frame of the Earth; lengths of paths stay finite
_UNIT_TOLERANCE = 1e-3  # of a quaternion's norm and a matrix's orthonormality: text files round


class PoseSource(StrEnum):
    """Where the poses of a drive come from."""

    GIVEN = "given"
    ODOMETRY = "odometry"


@dataclass(frozen=True)
class Pose:
    """Position and orientation of the sensor in the world.

    Examples:
        >>> round(Pose.from_matrix([[0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7]]).yaw_deg, 6)
        90.0
    """

    x_m: float
    y_m: float
    z_m: float
    qx: float = 0.0
    qy: float = 0.0
    qz: float = 0.0
    qw: float = 1.0

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, self.as_tuple())):
            raise InvalidPose(f"a pose is seven finite numbers, got {self.as_tuple()}")
        farthest_m = max(abs(self.x_m), abs(self.y_m), abs(self.z_m))
        if farthest_m > _FARTHEST_M:
            raise InvalidPose(f"a pose is {farthest_m:g} m away, wanted at most {_FARTHEST_M:g}")
        norm = math.hypot(self.qx, self.qy, self.qz, self.qw)
        if abs(norm - 1.0) > _UNIT_TOLERANCE:
            raise InvalidPose(f"the quaternion has norm {norm:.6g}, wanted 1")

    def as_tuple(self) -> tuple[float, float, float, float, float, float, float]:
        """Return `(x, y, z, qx, qy, qz, qw)`."""
        return (self.x_m, self.y_m, self.z_m, self.qx, self.qy, self.qz, self.qw)

    @property
    def yaw_deg(self) -> float:
        """Heading of the sensor's x axis in the world's x-y plane, counter-clockwise."""
        x, y, z, w = self.qx, self.qy, self.qz, self.qw
        return math.degrees(math.atan2(2.0 * (x * y + z * w), 1.0 - 2.0 * (y * y + z * z)))

    @classmethod
    def from_row(cls, row: ArrayLike) -> "Pose | None":
        """Return the pose in a row of seven numbers, `None` if the row is unknown (NaN)."""
        values = np.asarray(row, dtype=np.float64)
        if values.shape != (7,):
            raise InvalidPose(f"a pose row has shape {values.shape}, wanted (7,)")
        numbers = values.tolist()
        return None if all(map(math.isnan, numbers)) else cls(*numbers)

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> "Pose":
        """Return the pose of a `(3, 4)` or `(4, 4)` matrix `[R | t]`.

        Raises:
            InvalidPose: If the shape is another or R is not a rotation.
        """
        rows = rows_from_matrices(np.asarray(matrix, dtype=np.float64)[None])
        return cls(*rows[0].tolist())


def rows_from_matrices(matrices: ArrayLike) -> FloatArray:
    """Turn `(n, 3, 4)` or `(n, 4, 4)` matrices into `(n, 7)` pose rows; NaN stays NaN.

    Raises:
        InvalidPose: If the shape is another or a matrix is no rotation.
    """
    m = np.asarray(matrices, dtype=np.float64)
    if m.ndim != 3 or m.shape[1:] not in {(3, 4), (4, 4)}:
        raise InvalidPose(f"pose matrices have shape {m.shape[1:]}, wanted (3, 4) or (4, 4)")
    rows = np.full((len(m), 7), np.nan)
    known = np.isfinite(m[:, :3]).all(axis=(1, 2))
    rotations = m[known, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # infinite or NaN then, and rejected
        residual = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0)
    if not residual <= _UNIT_TOLERANCE:
        raise InvalidPose(f"a pose matrix is no rotation: R R^T differs from I by {residual:.3g}")
    if (np.linalg.det(rotations) < 0).any():
        raise InvalidPose("a pose matrix is no rotation: it mirrors")
    rows[known, :3] = m[known, :3, 3]
    if known.any():
        from scipy.spatial.transform import Rotation  # no answer needs it: decision 33

        rows[known, 3:] = Rotation.from_matrix(rotations).as_quat(canonical=True)
    return rows


def pose_rows(poses: list[Pose | None]) -> FloatArray:
    """Stack poses into `(n, 7)`, NaN where `None`."""
    rows = [UNKNOWN_POSE if pose is None else pose.as_tuple() for pose in poses]
    return np.array(rows, dtype=np.float64).reshape(-1, 7)


def digest_of_poses(rows: FloatArray) -> str:
    """Return the SHA-256 digest of `(n, 7)` pose rows, in hex; the catalog keeps such."""
    return hashlib.sha256(rows.astype("<f8").tobytes()).hexdigest()


def first_invalid(rows: FloatArray) -> int | None:
    """Return the first of `(n, 7)` pose rows that is neither wholly unknown nor a pose."""
    unknown = np.isnan(rows).all(axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        off_unit = np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0)
        near = (np.abs(rows[:, :3]) <= _FARTHEST_M).all(axis=1)
        wrong = ~unknown & ~(is_known(rows) & near & (off_unit <= _UNIT_TOLERANCE))
    return int(wrong.argmax()) if wrong.any() else None


def matrices_from_rows(rows: FloatArray) -> FloatArray:
    """Turn `(n, 7)` pose rows into `(n, 4, 4)` matrices; NaN stays NaN.

    Examples:
        >>> rows = np.array([[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0], [np.nan] * 7])
        >>> bool(np.array_equal(rows_from_matrices(matrices_from_rows(rows)), rows, equal_nan=True))
        True
    """
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    known = is_known(rows)
    poses[~known, :3] = np.nan
    if known.any():
        from scipy.spatial.transform import Rotation  # no answer needs it: decision 33

        poses[known, :3, :3] = Rotation.from_quat(rows[known, 3:]).as_matrix()
        poses[known, :3, 3] = rows[known, :3]
    return poses


def is_known(rows: FloatArray) -> BoolArray:
    """Return which of `(n, 7)` pose rows are known, `(n,)`."""
    return np.asarray(np.isfinite(rows).all(axis=1))


def verticals(rows: FloatArray) -> FloatArray:
    """Return the z axes of the sensors of `(n, 7)` pose rows, `(n, 3)`, NaN where unknown."""
    x, y, z, w = rows[:, 3:].T
    return np.column_stack(
        [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x**2 + y**2)]
    )


def heading_deg(rows: FloatArray) -> FloatArray:
    """Return the headings of `(n, 7)` pose rows, `(n,)` degrees in -180..180, NaN where unknown."""
    x, y, z, w = rows[:, 3:].T
    forward_x, forward_y = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w)
    return np.asarray(np.degrees(np.arctan2(forward_y, forward_x)))
