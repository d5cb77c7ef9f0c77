"""Placements: how the poses of drives came into the frame of their map."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from core.arrays import FloatArray
from core.attributes import Attributes
from core.errors import InvalidMap, InvalidParameters
from core.scans.rigid import RigidTransform
from core.scans.trajectory import Trajectory
from core.text import LONGEST_NAME, flaw_in

_FARTHEST_M = 1e9  # more than the poses of any two frames are apart
_MOST_DEG = 180.0


@dataclass(frozen=True)
class Placement(Attributes):
    """The transform from a drive's own poses to those of the map, and how well it is known.

    Attributes:
        rotation: The rotation of the drive's frame, a unit quaternion, qx, qy, qz, qw.
        translation_m: x, y and z, after the rotation.
        others: The drives that it was fitted to, or the first one left of those that lie beside
            the others with it; none if it met none. Whether it lies in the frame of the map is
            known from all of its drives: `core.mapping.components`.
        matches: Number of matched scans that agree.
        spread_m: Standard deviation of one of them in x and y, each.
        centre_m: The middle of the matched places in the map.
        error_m: Standard deviation of the position there.
        error_deg: Standard deviation of the heading.
    """

    rotation: tuple[float, float, float, float]
    translation_m: tuple[float, float, float]
    others: tuple[str, ...] = ()
    matches: int = 0
    spread_m: float = 0.0
    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    error_m: float = 0.0
    error_deg: float = 0.0

    def __post_init__(self) -> None:
        self._set_numbers("rotation", 4, -1.001, 1.001)
        for name in ("translation_m", "centre_m"):
            self._set_numbers(name, 3, -_FARTHEST_M, _FARTHEST_M)
        if abs(float(np.linalg.norm(self.rotation)) - 1.0) > 1e-6:
            raise InvalidParameters(f"rotation is {self.rotation}, wanted a unit quaternion")
        for name, most in (("spread_m", _FARTHEST_M), ("error_m", _FARTHEST_M)):
            self._require_within(name, most)
        self._require_within("error_deg", _MOST_DEG)
        if isinstance(self.matches, bool) or not isinstance(self.matches, int) or self.matches < 0:
            raise InvalidParameters(f"matches is {self.matches!r}, wanted a whole number from 0")
        object.__setattr__(self, "others", tuple(self.others))
        for name in self.others:
            flaw = flaw_in(name, LONGEST_NAME)
            if flaw is not None:
                raise InvalidParameters(f"others holds {ascii(name)[:80]}: {flaw}")

    def _require_within(self, name: str, most: float) -> None:
        value = float(getattr(self, name))
        object.__setattr__(self, name, value)
        if not 0.0 <= value <= most:
            raise InvalidParameters(f"{name} is {value}, wanted 0..{most:g}")

    @property
    def transform(self) -> RigidTransform:
        """The transform itself."""
        from scipy.spatial.transform import Rotation  # no answer needs it: decision 33

        rotation = Rotation.from_quat(self.rotation).as_matrix()
        return RigidTransform(rotation, np.array(self.translation_m))

    @classmethod
    def of(cls, transform: RigidTransform) -> "Placement":
        """Return the placement of a transform, without others and figures of a fit."""
        from scipy.spatial.transform import Rotation  # no answer needs it: decision 33

        quaternion = Rotation.from_matrix(transform.rotation).as_quat(canonical=True)
        return cls(tuple(quaternion.tolist()), tuple(transform.translation_m.tolist()))

    def after(self, first: "Placement") -> "Placement":
        """Return this placement, of poses that another one had transformed before."""
        both = type(self).of(self.transform.after(first.transform))
        return replace(self, rotation=both.rotation, translation_m=both.translation_m)

    def __str__(self) -> str:
        transform = self.transform
        if not self.others:
            return str(transform.about(np.zeros(3)))
        middle_m = (np.array(self.centre_m) - transform.translation_m) @ transform.rotation
        return (
            f"{transform.about(middle_m)}, into the frame of {', '.join(self.others)}:"
            f" {self.matches} matches agree within {self.spread_m:.2f} m (standard deviation),"
            f" so that at their middle it is known to {self.error_m:.2f} m and"
            f" {self.error_deg:.2f} deg"
        )


def placed(trajectory: Trajectory, transforms: Mapping[str, RigidTransform]) -> Trajectory:
    """Return a trajectory with the poses of some drives transformed."""
    poses = trajectory.poses.copy()
    for name in trajectory.drives:
        if name in transforms:
            rows = trajectory.rows_of(name)
            poses[rows] = transforms[name].apply_to_poses(poses[rows])
    return replace(trajectory, poses=poses)


def composed(first: Mapping[str, Placement], then: Mapping[str, Placement]) -> dict[str, Placement]:
    """Return the placements of drives that were transformed once, and some of them again."""
    again = {
        name: placement.after(first[name]) if name in first else placement
        for name, placement in then.items()
    }
    return {**first, **again}


def placements_from_attributes(attributes: Mapping[str, Any]) -> dict[str, Placement]:
    """Return the placements of a map's attributes, none if it has none.

    Raises:
        InvalidMap: If one cannot be read, or is of a drive that the map does not have.
    """
    stored = attributes.get("placements", {})
    if not isinstance(stored, Mapping) or ("placements" in attributes and not stored):
        raise InvalidMap(f"placements is {stored!r:.80}, wanted an object of drives")
    unknown = sorted(set(stored) - set(attributes["drives"]))
    if unknown:
        raise InvalidMap(f"placements holds {unknown[0]!a:.80}, which is no drive of the map")
    return {name: Placement.from_attributes(values) for name, values in stored.items()}


def beside(poses: FloatArray, others: FloatArray, gap_m: float) -> RigidTransform:
    """Return the transform that puts poses to the east (+x) of others, `gap_m` away."""
    x_m = np.nanmax(others[:, 0]) + gap_m - np.nanmin(poses[:, 0])
    return RigidTransform(np.eye(3), np.array([x_m, 0.0, 0.0]))
