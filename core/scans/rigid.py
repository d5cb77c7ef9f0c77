"""Rigid transforms between world frames, and rigid poses as `(4, 4)` matrices."""

from dataclasses import dataclass

import numpy as np

from core.arrays import FloatArray, freeze
from core.scans.pose import is_known


@dataclass(frozen=True, eq=False)
class RigidTransform:
    """From one world frame to another, `q = R p + t`.

    Attributes:
        rotation: `(3, 3)`, R.
        translation_m: `(3,)`, t.
    """

    rotation: FloatArray
    translation_m: FloatArray

    def __post_init__(self) -> None:
        freeze(self, rotation=np.float64, translation_m=np.float64)

    @property
    def yaw_deg(self) -> float:
        """Rotation about the vertical, counter-clockwise, -180..180."""
        return float(np.degrees(np.arctan2(self.rotation[1, 0], self.rotation[0, 0])))

    @property
    def tilt_deg(self) -> float:
        """Angle between the vertical axes of both frames, 0..180."""
        return float(np.degrees(np.arccos(np.clip(self.rotation[2, 2], -1.0, 1.0))))

    def about(self, point_m: FloatArray) -> str:
        """Return the transform in words: a rotation about a point, and then a shift.

        In frames such as UTM the origin is far away: about it a tenth of a degree is
        kilometres, and the shift says nothing of the drive.

        Args:
            point_m: `(3,)` a point of the first frame in the middle of what is transformed.

        Examples:
            >>> turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
            >>> RigidTransform(turn, np.array([20.0, 0, 0])).about(np.array([10.0, 0, 0]))
            'turned by 90.000 deg about (10.0, 0.0, 0.0) and then moved by (10.00, 10.00, 0.00) m'
        """
        point_m = point_m.round(1)
        (x_m, y_m, z_m), by_m = point_m.tolist(), self.apply(point_m[None])[0] - point_m
        tilted = f", tilted by {self.tilt_deg:.1f} deg" if self.tilt_deg > 1.0 else ""
        shift = ", ".join(f"{value:z.2f}" for value in by_m.tolist())
        return (
            f"turned by {self.yaw_deg:z.3f} deg{tilted} about ({x_m:z.1f}, {y_m:z.1f}, {z_m:z.1f})"
            f" and then moved by ({shift}) m"
        )

    def apply(self, points_m: FloatArray) -> FloatArray:
        """Return `(n, 3)` points in the other frame."""
        return np.asarray(points_m @ self.rotation.T + self.translation_m)

    def apply_to_poses(self, rows: FloatArray) -> FloatArray:
        """Return `(n, 7)` pose rows in the other frame; NaN stays NaN."""
        from scipy.spatial.transform import Rotation  # no answer needs it: decision 33

        moved = rows.copy()
        known = is_known(rows)
        if known.any():
            turned = Rotation.from_matrix(self.rotation) * Rotation.from_quat(rows[known, 3:])
            moved[known, :3] = self.apply(rows[known, :3])
            moved[known, 3:] = turned.as_quat(canonical=True)
        return moved

    def after(self, first: "RigidTransform") -> "RigidTransform":
        """Return the transform that applies another one first, and then this one."""
        return RigidTransform(
            self.rotation @ first.rotation, self.apply(first.translation_m[None])[0]
        )

    @classmethod
    def fit(
        cls,
        points_m: FloatArray,
        others_m: FloatArray,
        *,
        level: bool,
        weights: FloatArray | None = None,
        turn_deg: FloatArray | None = None,
        verticals: tuple[FloatArray, FloatArray] | None = None,
        lever_m: float = 0.0,
    ) -> "RigidTransform":
        """Return the least-squares transform of `(n, 3)` points to others (Kabsch 1976).

        Args:
            points_m: The points in one frame.
            others_m: The points in the other frame.
            level: Rotate about the vertical only.
            weights: `(n,)` of the pairs; equal by default.
            turn_deg: `(n,)` the rotation as each pair has it, of a level transform.
            verticals: For a transform that is not level, the `(n, 3)` verticals at the points and
                at the others: positions along a line do not fix the rotation about it.
            lever_m: How far two points would be apart that give either as exactly.

        Examples:
            >>> ahead = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 5.0, 0.0]])
            >>> turned = np.array([[0.0, 0.0, 0.0], [0.0, 10.0, 0.0], [-5.0, 10.0, 0.0]])
            >>> found = RigidTransform.fit(ahead, turned + [500.0, 0.0, 0.0], level=True)
            >>> round(found.yaw_deg, 6), found.translation_m.round(6).tolist()
            (90.0, [500.0, 0.0, 0.0])
        """
        share = np.ones(len(points_m)) if weights is None else weights
        share = share[:, None] / share.sum()
        middle, other_middle = (share * points_m).sum(axis=0), (share * others_m).sum(axis=0)
        product = (share * (others_m - other_middle)).T @ (points_m - middle)
        if level:
            sine, cosine = product[1, 0] - product[0, 1], product[0, 0] + product[1, 1]
            if turn_deg is not None:
                turn = np.radians(turn_deg)
                sine += lever_m**2 * float(share[:, 0] @ np.sin(turn))
                cosine += lever_m**2 * float(share[:, 0] @ np.cos(turn))
            rotation = about_vertical(np.array([np.arctan2(sine, cosine)]))[0]
        else:
            if verticals is not None:
                vertical, other_vertical = verticals
                product += lever_m**2 * (share * other_vertical).T @ vertical
            rotation = proper_rotations(product[None])[0]
        return cls(rotation, other_middle - rotation @ middle)


def proper_rotations(product: FloatArray) -> FloatArray:
    """Return the rotations nearest to `(n, 3, 3)` matrices, without reflections."""
    u, _, vt = np.linalg.svd(product)
    u[:, :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[:, None]
    return np.asarray(u @ vt)


def about_vertical(angle: FloatArray) -> FloatArray:
    """Return the rotations about the vertical by `(n,)` angles in radians, `(n, 3, 3)`."""
    from scipy.spatial.transform import Rotation  # no answer needs it: decision 33

    return np.asarray(Rotation.from_euler("z", angle[:, None]).as_matrix())


def inverse(poses: FloatArray) -> FloatArray:
    """Return the inverse of `(..., 4, 4)` poses.

    Examples:
        >>> ahead = planar(2.0, 0.0, 90.0)
        >>> bool(np.allclose(inverse(ahead) @ ahead, np.eye(4)))
        True
    """
    inverted = np.zeros_like(poses)
    turned_back = np.swapaxes(poses[..., :3, :3], -1, -2)
    inverted[..., :3, :3] = turned_back
    inverted[..., :3, 3] = -(turned_back @ poses[..., :3, 3:])[..., 0]
    inverted[..., 3, 3] = 1.0
    return inverted


def exact(pose: FloatArray) -> FloatArray:
    """Return a `(4, 4)` pose whose rotation is one, but for rounding.

    Products of many rotations are not, and KISS-ICP aborts the process where one is not.

    Examples:
        >>> skewed = planar(1.0, 0.0, 30.0) + 1e-6
        >>> rotation = exact(skewed)[:3, :3]
        >>> bool(np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-14)
        True
    """
    made = pose.copy()
    made[:3, :3] = proper_rotations(pose[None, :3, :3])[0]
    return made


def planar(forward_m: float, left_m: float, turn_deg: float) -> FloatArray:
    """Return the pose of what is ahead and to the left, turned counter-clockwise."""
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    pose = np.eye(4)
    pose[:2, :2] = [[cos, -sin], [sin, cos]]
    pose[:2, 3] = forward_m, left_m
    return pose


def rotation_deg(poses: FloatArray) -> FloatArray:
    """Return the angles of `(..., 3, 3)` rotations, or of those of `(..., 4, 4)` poses."""
    cosine = (np.trace(poses[..., :3, :3], axis1=-2, axis2=-1) - 1.0) / 2.0
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def are_near(pose: FloatArray, other: FloatArray, most_m: float, most_deg: float) -> bool:
    """Return whether two `(4, 4)` poses are so near, the angle about any axis.

    Examples:
        >>> are_near(planar(2.0, 0.0, 5.0), planar(3.0, 0.0, 0.0), 1.0, 4.9)
        False
    """
    off = inverse(pose) @ other
    return bool(np.linalg.norm(off[:3, 3]) <= most_m and rotation_deg(off) <= most_deg)
