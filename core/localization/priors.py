"""Priors, `Hints` on the wire: what a vehicle knows of where it is before it queries (sec. 4).

A hint is a gate at three standard deviations, and within it a prior: among scans that are about as
near the likelier place wins.
"""

import math
from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray
from core.encodings.model import Neighbours, Search
from core.errors import InvalidParameters
from core.mapping.tensormap import TensorMap
from core.scans.angles import wrapped_deg
from core.scans.pose import heading_deg

_GATE = 3.0  # standard deviations
_REACH_M = 5.0  # a scan of the map answers for what is so near to it: half a gap, and a lane
_HEADING_SLACK_DEG = 5.0  # of a path's heading between two scans, and of its estimate
_FIRST = 32  # scans that are asked for at first when headings have to be looked at


def _require_sigma(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise InvalidParameters(f"{name} is {value}, wanted above 0")


def _require_finite(name: str, value: float) -> None:
    if not math.isfinite(value):
        raise InvalidParameters(f"{name} is {value}, wanted a finite number")


@dataclass(frozen=True)
class PositionHint:
    """Where the vehicle is about, as satellites tell it.

    Attributes:
        x_m: In the map's frame.
        y_m: Likewise.
        sigma_m: Standard deviation of either.
    """

    x_m: float
    y_m: float
    sigma_m: float

    def __post_init__(self) -> None:
        _require_finite("x_m", self.x_m)
        _require_finite("y_m", self.y_m)
        _require_sigma("position_sigma_m", self.sigma_m)


@dataclass(frozen=True)
class HeadingHint:
    """Which way the vehicle looks, as a compass tells it.

    Attributes:
        heading_deg: In the map's frame, counter-clockwise from x.
        sigma_deg: Standard deviation.
    """

    heading_deg: float
    sigma_deg: float

    def __post_init__(self) -> None:
        _require_finite("heading_deg", self.heading_deg)
        _require_sigma("heading_sigma_deg", self.sigma_deg)


@dataclass(frozen=True)
class ScanOfMap:
    """A scan that a fix named.

    Attributes:
        drive: Its drive.
        scan_index: Its index in that drive.
    """

    drive: str
    scan_index: int


@dataclass(frozen=True)
class OdometryHint:
    """How far the vehicle has come since it last knew where it was.

    Where it turned is not known: it is within that distance, as the crow flies.

    Attributes:
        since: The last fix: a scan of the map, or x and y in its frame, metres.
        travelled_m: Driven since then, at least 0.
        sigma_m: Standard deviation of that, the fix's own included.
    """

    since: ScanOfMap | tuple[float, float]
    travelled_m: float
    sigma_m: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.travelled_m) and self.travelled_m >= 0.0):
            raise InvalidParameters(f"travelled_m is {self.travelled_m}, wanted at least 0")
        _require_sigma("travelled_sigma_m", self.sigma_m)
        if not isinstance(self.since, ScanOfMap):
            for name, value in zip(("since_x_m", "since_y_m"), self.since, strict=True):
                _require_finite(name, value)


@dataclass(frozen=True)
class Hints:
    """All that is known; what is `None` is not.

    Attributes:
        position: Where it is about.
        heading: Which way it looks.
        odometry: How far it has come.
        segments: It is on one of these.
    """

    position: PositionHint | None = None
    heading: HeadingHint | None = None
    odometry: OdometryHint | None = None
    segments: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        if self.segments is not None:
            object.__setattr__(self, "segments", tuple(sorted(set(self.segments))))
            if not self.segments:
                raise InvalidParameters("segments is empty, wanted at least one")


NO_HINTS = Hints()
"""Nothing is known."""


class Prior:
    """Hints as they look on one map.

    Attributes:
        rows: `(K,)` which scans come into question.
        share: Of all scans and headings, how many do; above 0 unless none does.

    Raises:
        InvalidParameters: If a hint is of places and the map has no poses, or names a scan that it
            does not have.
        UnknownSegment: If the map has no such segment.
    """

    def __init__(self, hints: Hints, tensor_map: TensorMap) -> None:
        trajectory = tensor_map.trajectory
        scans = len(trajectory)
        self.rows: BoolArray = np.ones(scans, dtype=bool)
        self._log_weight: FloatArray = np.zeros(scans)
        self._heading: HeadingHint | None = None
        self._path_heading_deg: FloatArray = np.zeros(scans)
        of_place = (hints.position, hints.heading, hints.odometry)
        if any(hint is not None for hint in of_place) and not trajectory.known.any():
            raise InvalidParameters("the map has no poses: a hint of a place says nothing in it")
        if hints.segments is not None:
            tensor_map.model.require_segments(np.array(hints.segments))
            self.rows &= np.isin(tensor_map.model.segment_of_scan, hints.segments)
        if hints.position is not None:
            self._apply_position(hints.position, trajectory.poses[:, :2])
        if hints.odometry is not None:
            since = _since(hints.odometry, tensor_map)
            self._apply_odometry(hints.odometry, since, trajectory.poses[:, :2])
        heading_share = 1.0
        if hints.heading is not None:
            self._path_heading_deg = heading_deg(trajectory.poses)
            if tensor_map.parameters.encoder.yaw_invariant:
                self._heading = hints.heading
                self.rows &= trajectory.known
                heading_share = min(1.0, 2.0 * _heading_gate_deg(hints.heading) / 360.0)
            else:  # a scan answers who looks as it was recorded, and no one else
                turn = wrapped_deg(self._path_heading_deg - hints.heading.heading_deg)
                self.rows &= np.abs(turn) <= _heading_gate_deg(hints.heading)
        self.share = float(self.rows.mean()) * heading_share

    def _apply_position(self, hint: PositionHint, places_m: FloatArray) -> None:
        off_m = np.hypot(places_m[:, 0] - hint.x_m, places_m[:, 1] - hint.y_m)
        self.rows &= off_m <= _GATE * hint.sigma_m + _REACH_M
        off_m = np.maximum(np.where(np.isnan(off_m), 0.0, off_m) - _REACH_M, 0.0)
        self._log_weight -= _half_square(off_m / hint.sigma_m)

    def _apply_odometry(
        self, hint: OdometryHint, since_m: tuple[float, float], places_m: FloatArray
    ) -> None:
        off_m = np.hypot(places_m[:, 0] - since_m[0], places_m[:, 1] - since_m[1])
        self.rows &= off_m <= hint.travelled_m + _GATE * hint.sigma_m + _REACH_M
        beyond_m = np.where(np.isnan(off_m), 0.0, off_m) - hint.travelled_m - _REACH_M
        self._log_weight -= _half_square(np.maximum(beyond_m, 0.0) / hint.sigma_m)

    @property
    def looks(self) -> bool:
        """Whether a match's heading has to be looked at."""
        return self._heading is not None

    def allows(self, found: Neighbours) -> BoolArray:
        """Return which matches lie within the gate, `(n,)`."""
        allowed = self.rows[found.rows]
        if self._heading is None:
            return allowed
        return allowed & (self._off_deg(found, self._heading) <= _heading_gate_deg(self._heading))

    def log_weight(self, found: Neighbours) -> FloatArray:
        """Return the logarithm of how likely each place is beforehand, `(n,)`, at most 0."""
        weight = self._log_weight[found.rows]
        if self._heading is None:
            return weight
        off_deg = np.maximum(self._off_deg(found, self._heading) - _HEADING_SLACK_DEG, 0.0)
        return np.asarray(weight - 0.5 * (off_deg / self._heading.sigma_deg) ** 2)

    def _off_deg(self, found: Neighbours, hint: HeadingHint) -> FloatArray:
        estimated = self._path_heading_deg[found.rows] + found.relative_yaw_deg
        # A single harmonic gives no relative yaw: nothing is off then.
        return np.nan_to_num(np.abs(wrapped_deg(estimated - hint.heading_deg)))


def nearest_within(
    search: Search, k: int, prior: Prior, among: BoolArray | None = None
) -> Neighbours:
    """Return the `k` nearest scans that a prior allows, nearest first, as many as there are."""
    rows = prior.rows if among is None else prior.rows & among
    if not prior.looks:
        return search.nearest(k, rows)
    asked = max(k, _FIRST)
    while True:
        found = search.nearest(asked, rows)
        allowed = found[prior.allows(found)]
        if len(allowed) >= k or len(found) < asked:
            return allowed[:k]
        asked *= 4


def _since(hint: OdometryHint, tensor_map: TensorMap) -> tuple[float, float]:
    if not isinstance(hint.since, ScanOfMap):
        return hint.since
    trajectory, named = tensor_map.trajectory, hint.since
    row = trajectory.row_of(named.drive, named.scan_index)
    if row is None:
        raise InvalidParameters(
            f"the map has no scan {named.scan_index} of a drive {named.drive[:64]!r}"
        )
    if not trajectory.known[row]:
        raise InvalidParameters(f"the pose of scan {named.scan_index} is not known")
    x_m, y_m = trajectory.poses[row, :2].tolist()
    return x_m, y_m


def _heading_gate_deg(hint: HeadingHint) -> float:
    return _GATE * hint.sigma_deg + _HEADING_SLACK_DEG


def _half_square(sigmas: FloatArray) -> FloatArray:
    """Return half the square of distances in standard deviations; beyond a million all are far."""
    return np.asarray(0.5 * np.minimum(sigmas, 1e6) ** 2)
