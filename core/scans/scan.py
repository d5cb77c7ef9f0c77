"""A scan: the returns of one revolution of the sensor."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from core.arrays import BoolArray, Float32Array, frozen
from core.errors import InvalidScan, TooFewReturns
from core.scans.pose import Pose


@dataclass(frozen=True, eq=False)
class Scan:
    """The returns of one revolution, in the sensor's frame (x forward, y left, z up).

    Attributes:
        points_m: `(n, 3)` float32 metres; every return finite and away from the origin.
        timestamp_s: Seconds, NaN where unknown.
        pose: Sensor to world, `None` where unknown.
        dropped_returns: Returns that were not finite or zero, and were left out.
        is_level: Whether z is known to be up, from gravity or the ground.

    Examples:
        >>> scan = Scan.from_returns([[10.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        >>> len(scan), scan.dropped_returns
        (1, 1)
    """

    points_m: Float32Array
    timestamp_s: float = math.nan
    pose: Pose | None = None
    dropped_returns: int = 0
    is_level: bool = False

    def __post_init__(self) -> None:
        _require_plain(self.points_m)
        points = np.asarray(self.points_m)
        if points.ndim != 2 or points.shape[1] != 3:
            raise InvalidScan(f"points_m has shape {points.shape}, wanted (n, 3)")
        points = frozen(points, np.float32)
        if not _is_return(points).all():
            raise InvalidScan(
                "points_m has returns that are not finite or zero; use Scan.from_returns"
            )
        _require_time(self.timestamp_s)
        object.__setattr__(self, "points_m", points)

    def __len__(self) -> int:
        return len(self.points_m)

    def __repr__(self) -> str:  # without the array
        rest = [f"returns={len(self)}", f"timestamp_s={self.timestamp_s}", f"pose={self.pose}"]
        rest += [f"dropped_returns={self.dropped_returns}", f"is_level={self.is_level}"]
        return f"Scan({', '.join(rest)})"

    @classmethod
    def from_returns(
        cls,
        returns_m: ArrayLike,
        *,
        min_returns: int = 1,
        timestamp_s: float = math.nan,
        pose: Pose | None = None,
        dropped_returns: int = 0,
        is_level: bool = False,
    ) -> "Scan":
        """Return the scan of a sensor's or file's rows; rows that are no returns are dropped.

        Args:
            returns_m: `(n, 3)` metres; non-finite and zero rows are dropped.
            min_returns: How many must remain.
            timestamp_s: Seconds, NaN where unknown.
            pose: Sensor to world, `None` where unknown.
            dropped_returns: Number of returns that were dropped before, of a scan that these rows
                are made from.
            is_level: Whether z is known to be up, from gravity or the ground.

        Raises:
            InvalidScan: If the shape is not `(n, 3)`, or the array is complex or masks a return.
            TooFewReturns: If fewer than `min_returns` remain.
        """
        _require_plain(returns_m)
        # Beyond float32 is infinite and a signalling NaN is a NaN: both are dropped.
        with np.errstate(over="ignore", invalid="ignore"):
            points = np.asarray(returns_m, dtype=np.float32, order="C")
        if points.ndim != 2 or points.shape[1] != 3:
            raise InvalidScan(f"returns have shape {points.shape}, wanted (n, 3)")
        keep = _is_return(points)
        kept = int(keep.sum())
        if kept < min_returns:
            raise TooFewReturns(
                f"{kept} of {len(points)} returns are finite and non-zero,"
                f" at least {min_returns} are wanted"
            )
        _require_time(timestamp_s)
        # Not by the constructor, which would check again what was kept.
        scan = object.__new__(cls)
        kept_m = frozen(points if kept == len(points) else points[keep], np.float32)
        object.__setattr__(scan, "points_m", kept_m)
        object.__setattr__(scan, "timestamp_s", timestamp_s)
        object.__setattr__(scan, "pose", pose)
        object.__setattr__(scan, "dropped_returns", dropped_returns + len(points) - kept)
        object.__setattr__(scan, "is_level", is_level)
        return scan


def _require_plain(values: ArrayLike) -> None:
    """Reject arrays of which NumPy would drop a part: imaginary parts, and a mask."""
    if not isinstance(values, np.ndarray):
        return
    if values.dtype.kind == "c":
        raise InvalidScan(f"returns are {values.dtype}, wanted real numbers: x, y, z in metres")
    if np.any(getattr(values, "mask", False)):
        raise InvalidScan(
            "returns are a masked array, wanted a plain one: Scan.from_returns of"
            " `.filled(numpy.nan)` leaves out what is masked"
        )


def _require_time(timestamp_s: float) -> None:
    if math.isinf(timestamp_s):
        raise InvalidScan(f"timestamp_s is {timestamp_s}, wanted seconds or NaN")


def _is_return(points_m: Float32Array) -> BoolArray:
    x, y, z = points_m.T  # column by column: eight times faster than reducing short rows
    with np.errstate(invalid="ignore"):  # a signalling NaN is a NaN, nothing to warn of
        keep = np.asarray(x != 0)
        if not keep.all():
            keep |= (y != 0) | (z != 0)
        if not np.isfinite(points_m).all():
            keep &= np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
        return keep
