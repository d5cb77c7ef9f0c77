"""Disturbances of queries: relative yaw, lateral offset, noise (paper, sec. 3.4)."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.arrays import FloatArray
from core.errors import InvalidParameters
from core.numbers import require_at_least
from core.scans.displacement import pose_beside, seen_from_beside
from core.scans.scan import Scan


@dataclass(frozen=True)
class Condition:
    """A disturbance of every query scan.

    The vehicle is `lateral_m` to the left of its recorded pose (negative: right), then rotated by
    `yaw_deg` counter-clockwise, p' = Rz(-yaw) (p - (0, d, 0)), and every coordinate of its returns
    has Gaussian noise. As in the paper the displacement is simulated: the returns are those seen
    from the recorded place.
    """

    yaw_deg: float = 0.0
    lateral_m: float = 0.0
    noise_m: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite([self.yaw_deg, self.lateral_m]).all():
            raise InvalidParameters(f"{self} has a number that is not finite")
        require_at_least(0, noise_m=self.noise_m)

    def apply(self, scan: Scan, rng: np.random.Generator) -> Scan:
        """Return the scan as the query vehicle would have it.

        Examples:
            >>> scan = Scan(np.array([[10.0, 5.0, 0.0]]))
            >>> beside = Condition(yaw_deg=90.0, lateral_m=5.0)
            >>> beside.apply(scan, np.random.default_rng(0)).points_m.round(3).tolist()
            [[0.0, -10.0, 0.0]]
        """
        if self == Condition():
            return scan
        points = seen_from_beside(scan.points_m, self.lateral_m, self.yaw_deg)
        if self.noise_m:
            points += rng.normal(scale=self.noise_m, size=points.shape)
        return Scan.from_returns(points, timestamp_s=scan.timestamp_s, pose=scan.pose)

    def pose(self, recorded: FloatArray) -> FloatArray:
        """Return the pose of the vehicle under this condition, of `(7,)` pose rows both."""
        return pose_beside(recorded, self.lateral_m, self.yaw_deg)


def conditions(
    yaw_deg: Sequence[float], lateral_m: Sequence[float], noise_m: Sequence[float]
) -> tuple[Condition, ...]:
    """Return the product of three lists."""
    return tuple(
        Condition(yaw, lateral, noise)
        for yaw, lateral, noise in itertools.product(yaw_deg, lateral_m, noise_m)
    )
