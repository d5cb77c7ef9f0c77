"""Conditions of queries: relative yaw, lateral offset, noise (paper, sec. 3.4), disturbances."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from core.arrays import FloatArray
from core.errors import InvalidParameters
from core.evaluation.disturbances import KITTI_RECORDING, Recording, parse_disturbances
from core.numbers import require_at_least, require_finite
from core.scans.displacement import pose_beside, seen_from_beside
from core.scans.scan import Scan

_MOST_YAW_DEG = 360.0  # of a vast angle no digit is left that is smaller than a turn
_MOST_NOISE_M = 1000.0  # more than a sensor sees


@dataclass(frozen=True)
class Condition:
    """What changes every query scan.

    The vehicle is `lateral_m` to the left of its recorded pose (negative: right), then rotated by
    `yaw_deg` counter-clockwise, p' = Rz(-yaw) (p - (0, d, 0)), and every coordinate of its returns
    has Gaussian noise. As in the paper the displacement is simulated: the returns are those seen
    from the recorded place, which also decides which answers are right. Disturbances come after the
    displacement and before the noise.

    Attributes:
        yaw_deg: Relative yaw.
        lateral_m: Offset to the left.
        noise_m: Standard deviation of the noise.
        disturb: One combination as `core.evaluation.disturbances.parse_disturbances` reads it, such
            as `hidden:60+truck:1`; none if empty.
    """

    yaw_deg: float = 0.0
    lateral_m: float = 0.0
    noise_m: float = 0.0
    disturb: str = ""

    def __post_init__(self) -> None:
        require_finite(yaw_deg=self.yaw_deg, lateral_m=self.lateral_m)
        if abs(self.yaw_deg) > _MOST_YAW_DEG:
            raise InvalidParameters(
                f"yaw_deg is {self.yaw_deg:g}, wanted -{_MOST_YAW_DEG:g} to {_MOST_YAW_DEG:g}"
            )
        require_at_least(0, noise_m=self.noise_m)
        if self.noise_m > _MOST_NOISE_M:
            raise InvalidParameters(
                f"noise_m is {self.noise_m:g}, wanted at most {_MOST_NOISE_M:g}"
            )
        if len(parse_disturbances(self.disturb)) != 1:
            raise InvalidParameters(f"disturb is {self.disturb!r}, wanted one combination")

    def apply(
        self, scan: Scan, rng: np.random.Generator, recording: Recording = KITTI_RECORDING
    ) -> Scan:
        """Return the scan as the query vehicle would have it.

        Args:
            scan: The recorded scan.
            rng: Source of noise and disturbances.
            recording: The sensor that recorded it.

        Examples:
            >>> scan = Scan(np.array([[10.0, 5.0, 0.0]]))
            >>> beside = Condition(yaw_deg=90.0, lateral_m=5.0)
            >>> beside.apply(scan, np.random.default_rng(0)).points_m.round(3).tolist()
            [[0.0, -10.0, 0.0]]
        """
        if self == Condition():
            return scan
        points = seen_from_beside(scan.points_m, self.lateral_m, self.yaw_deg)
        recording = replace(recording, turned_deg=self.yaw_deg)
        for disturbance in parse_disturbances(self.disturb)[0]:
            points = disturbance.apply(points, recording, rng)
        if self.noise_m:
            points += rng.normal(scale=self.noise_m, size=points.shape)
        return Scan.from_returns(points, timestamp_s=scan.timestamp_s, pose=scan.pose)

    def pose(self, recorded: FloatArray) -> FloatArray:
        """Return the pose of the vehicle under this condition, of `(7,)` pose rows both."""
        return pose_beside(recorded, self.lateral_m, self.yaw_deg)


def conditions(
    yaw_deg: Sequence[float],
    lateral_m: Sequence[float],
    noise_m: Sequence[float],
    disturb: Sequence[str] = ("",),
) -> tuple[Condition, ...]:
    """Return the product of four lists."""
    product = itertools.product(yaw_deg, lateral_m, noise_m, disturb)
    return tuple(itertools.starmap(Condition, product))
