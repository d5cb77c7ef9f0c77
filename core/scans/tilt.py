"""The tilt of a vehicle, as its inertial sensor measures gravity."""

from dataclasses import dataclass, fields

import numpy as np

from core.errors import InvalidParameters
from core.scans.scan import Scan

STEEPEST_DEG = 45.0
"""Largest roll and pitch: beyond, a vehicle has fallen over, or its numbers are wrong."""


@dataclass(frozen=True)
class Tilt:
    """Roll and pitch of a vehicle's frame, or of a sensor without a mounting, against gravity.

    Signs are those of a mounting: the vehicle's axes are level ones, rotated by the roll about x
    and then by the pitch about y, R = Ry(pitch) Rx(roll). The heading does not change.

    Attributes:
        roll_deg: About x, right side down.
        pitch_deg: About y, front down.

    Raises:
        InvalidParameters: If one is not within 45 degrees.

    Examples:
        Of a vehicle whose front is down by 30 degrees, what is straight ahead is below it.

        >>> ahead = Scan.from_returns([[10.0, 0.0, 0.0]])
        >>> levelled = Tilt(roll_deg=0.0, pitch_deg=30.0).level(ahead)
        >>> levelled.points_m.astype(float).round(2).tolist()
        [[8.66, 0.0, -5.0]]
    """

    roll_deg: float
    pitch_deg: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not -STEEPEST_DEG <= value <= STEEPEST_DEG:
                raise InvalidParameters(
                    f"{field.name} is {value}, wanted -{STEEPEST_DEG:g} to {STEEPEST_DEG:g}"
                )

    @classmethod
    def of(cls, roll_deg: float | None, pitch_deg: float | None) -> "Tilt | None":
        """Return the tilt of both angles, `None` without them.

        Raises:
            InvalidParameters: If only one is given, or one is out of its range.
        """
        if roll_deg is None and pitch_deg is None:
            return None
        if roll_deg is None or pitch_deg is None:
            raise InvalidParameters(
                f"roll_deg is {roll_deg} and pitch_deg is {pitch_deg}, wanted both or neither"
            )
        return cls(roll_deg, pitch_deg)

    def level(self, scan: Scan) -> Scan:
        """Return a scan with level axes, `is_level`, its origin and its pose as they were.

        Raises:
            TooFewReturns: If no return is left that is finite and away from the origin.
        """
        from scipy.spatial.transform import Rotation  # few answers need it: decision 33

        angles_deg = (self.roll_deg, self.pitch_deg)
        rotation = Rotation.from_euler("xy", angles_deg, degrees=True)
        points_m = rotation.apply(scan.points_m.astype(np.float64))
        return Scan.from_returns(
            points_m,
            timestamp_s=scan.timestamp_s,
            pose=scan.pose,
            dropped_returns=scan.dropped_returns,
            is_level=True,
        )
