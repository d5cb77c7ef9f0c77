"""Priors: what a vehicle knows of its place before the search (paper, sec. 4).

A prior removes scans beyond three standard deviations, and weights the others by their probability.
"""

from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray
from core.encodings.search import Neighbours, Search
from core.errors import InvalidParameters
from core.mapping.tensormap import TensorMap
from core.numbers import require_above, require_at_least, require_finite
from core.scans.angles import wrapped_deg
from core.scans.trajectory import Trajectory

_GATE = 3.0  # standard deviations
_HEADING_SLACK_DEG = 5.0  # error of a path's heading between two scans, and of the relative yaw
_FIRST = 32  # scans of the first search, if matches are then filtered by heading
# Scans of the last one: of wrong matches two in five have the heading, so where none of so many has
# it the prior is wrong. Without a bound such a query compares the whole map exactly.
_MOST = 1024


@dataclass(frozen=True)
class PositionPrior:
    """Approximate position, as from GNSS.

    Attributes:
        x_m: The position's x in the map's frame.
        y_m: The position's y in the map's frame.
        sigma_m: Standard deviation of either.
    """

    x_m: float
    y_m: float
    sigma_m: float

    def __post_init__(self) -> None:
        require_finite(x_m=self.x_m, y_m=self.y_m)
        require_above(0, position_sigma_m=self.sigma_m)


@dataclass(frozen=True)
class HeadingPrior:
    """Approximate heading, as from a compass.

    Attributes:
        heading_deg: The heading in the map's frame, counter-clockwise from x.
        sigma_deg: Standard deviation.
    """

    heading_deg: float
    sigma_deg: float

    def __post_init__(self) -> None:
        require_finite(heading_deg=self.heading_deg)
        require_above(0, heading_sigma_deg=self.sigma_deg)

    @property
    def gate_deg(self) -> float:
        """The largest difference of a match's heading."""
        return _GATE * self.sigma_deg + _HEADING_SLACK_DEG


@dataclass(frozen=True)
class ScanOfMap:
    """A scan of the map as the last fix.

    Attributes:
        drive: The scan's drive.
        scan_index: The scan's index in that drive.
    """

    drive: str
    scan_index: int


@dataclass(frozen=True)
class OdometryPrior:
    """Distance driven since the last fix.

    The path is not known: the vehicle is within that distance of the fix, in a straight line.

    Attributes:
        since: The last fix: a scan of the map, or x and y in its frame, metres.
        travelled_m: Driven since then, at least 0.
        sigma_m: Standard deviation of that, the fix's own included.
    """

    since: ScanOfMap | tuple[float, float]
    travelled_m: float
    sigma_m: float

    def __post_init__(self) -> None:
        require_at_least(0, travelled_m=self.travelled_m)
        require_above(0, travelled_sigma_m=self.sigma_m)
        if not isinstance(self.since, ScanOfMap):
            require_finite(since_x_m=self.since[0], since_y_m=self.since[1])


@dataclass(frozen=True)
class Priors:
    """All priors of a query; `None` where there is none.

    Attributes:
        position: Approximate position.
        heading: Approximate heading.
        odometry: Distance driven since the last fix.
        segments: The segments that the vehicle may be on.
    """

    position: PositionPrior | None = None
    heading: HeadingPrior | None = None
    odometry: OdometryPrior | None = None
    segments: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        if self.segments is not None:
            object.__setattr__(self, "segments", tuple(sorted(set(self.segments))))
            if not self.segments:
                raise InvalidParameters("segments is empty, wanted at least one")


NO_PRIORS = Priors()


class MapPrior:
    """The priors of a query in one map: which scans are possible, and how likely each is.

    Attributes:
        rows: `(K,)` which scans are possible.
        undecided: `(K,)` which scans are neither possible nor known to be outside, because a prior
            needs their pose and that is unknown.
        share: The share of places that are possible in some heading, where each stand of the
            mapping vehicle is one place; above 0 unless none is.

    Raises:
        InvalidParameters: If a prior needs poses and the map has none, or names a scan that the map
            does not have.
        UnknownSegment: If the map has no such segment.
    """

    def __init__(self, priors: Priors, tensor_map: TensorMap) -> None:
        trajectory = tensor_map.trajectory
        scans = len(trajectory)
        self.rows: BoolArray = np.ones(scans, dtype=bool)
        self._log_weight: FloatArray = np.zeros(scans)
        self._heading: HeadingPrior | None = None
        self._path_heading_deg: FloatArray = np.zeros(scans)
        position, heading, odometry = priors.position, priors.heading, priors.odometry
        needs_poses = bool(position or heading or odometry)
        if needs_poses and not trajectory.known.any():
            raise InvalidParameters(
                "the map has no poses, which a prior of position, heading or odometry needs"
            )
        if priors.segments is not None:
            tensor_map.model.require_segments(np.array(priors.segments))
            self.rows &= np.isin(tensor_map.model.segment_of_scan, priors.segments)
        self.undecided: BoolArray = self.rows & ~trajectory.known & needs_poses
        if position is not None:
            self._apply_place(trajectory, (position.x_m, position.y_m), 0.0, position.sigma_m)
        if odometry is not None:
            since_m = _since_m(odometry, tensor_map)
            self._apply_place(trajectory, since_m, odometry.travelled_m, odometry.sigma_m)
        if heading is not None:
            self.rows &= trajectory.known
        # Streets are aligned: of the nearest wrong matches two in five have the heading whatever
        # the gate (docs/decisions/0011-trust.md), so that a heading leaves out few of them.
        self.share = trajectory.count_places(self.rows) / len(trajectory.first_of_stands)
        if heading is not None:
            self._path_heading_deg = trajectory.headings_deg
            if tensor_map.parameters.encoder.yaw_invariant:
                self._heading = heading
            else:  # a scan matches only queries in the heading of its recording
                off_deg = wrapped_deg(self._path_heading_deg - heading.heading_deg)
                self.rows &= np.abs(off_deg) <= heading.gate_deg

    def _apply_place(
        self,
        trajectory: Trajectory,
        from_m: tuple[float, float],
        travelled_m: float,
        sigma_m: float,
    ) -> None:
        """Require scans within `travelled_m` of a place, and weight those beyond it."""
        places_m = trajectory.poses[:, :2]
        with np.errstate(over="ignore"):  # as far as can be then
            off_m = np.hypot(places_m[:, 0] - from_m[0], places_m[:, 1] - from_m[1])
        beyond_m = off_m - travelled_m - trajectory.reach_m
        self.rows &= beyond_m <= _GATE * sigma_m
        beyond_m[np.isnan(off_m)] = 0.0
        with np.errstate(over="ignore"):
            sigmas = np.maximum(beyond_m, 0.0) / sigma_m
        sigmas = np.minimum(sigmas, 1e6)  # its square stays finite
        self._log_weight -= 0.5 * sigmas**2

    @property
    def depends_on_heading(self) -> bool:
        """Whether matches are filtered by their heading."""
        return self._heading is not None

    def allows(self, found: Neighbours) -> BoolArray:
        """Return which matches are within the gate, `(n,)`."""
        allowed = self.rows[found.rows]
        if self._heading is None:
            return allowed
        return allowed & (self._off_deg(found, self._heading) <= self._heading.gate_deg)

    def log_weight(self, found: Neighbours) -> FloatArray:
        """Return the logarithm of each match's prior weight, `(n,)`, at most 0."""
        weight = self._log_weight[found.rows]
        if self._heading is None:
            return weight
        off_deg = np.maximum(self._off_deg(found, self._heading) - _HEADING_SLACK_DEG, 0.0)
        return np.asarray(weight - 0.5 * (off_deg / self._heading.sigma_deg) ** 2)

    def _off_deg(self, found: Neighbours, prior: HeadingPrior) -> FloatArray:
        estimated = self._path_heading_deg[found.rows] + found.relative_yaw_deg
        # With a single harmonic the relative yaw is NaN: the difference counts as 0.
        return np.nan_to_num(np.abs(wrapped_deg(estimated - prior.heading_deg)))


def nearest_within(
    search: Search, k: int, prior: MapPrior, among: BoolArray | None = None
) -> Neighbours:
    """Return the `k` nearest scans that a prior allows, nearest first, or as many as there are.

    By heading only the 1,024 nearest of the scans that other priors allow are filtered, or `k`.
    """
    rows = prior.rows if among is None else prior.rows & among
    if not prior.depends_on_heading:
        return search.nearest(k, rows)
    most = max(k, _MOST)
    count = max(k, _FIRST)
    while True:
        found = search.nearest(count, rows)
        allowed = found[prior.allows(found)]
        if len(allowed) >= k or len(found) < count or count == most:
            return allowed[:k]
        count = min(4 * count, most)


def _since_m(prior: OdometryPrior, tensor_map: TensorMap) -> tuple[float, float]:
    """Return x and y of the last fix."""
    fix = prior.since
    if not isinstance(fix, ScanOfMap):
        return fix
    trajectory = tensor_map.trajectory
    row = trajectory.row_of(fix.drive, fix.scan_index)
    if row is None:
        raise InvalidParameters(
            f"the map has no scan {fix.scan_index} of a drive {fix.drive[:64]!r}"
        )
    if not trajectory.known[row]:
        raise InvalidParameters(f"the pose of scan {fix.scan_index} is not known")
    x_m, y_m = trajectory.poses[row, :2].tolist()
    return x_m, y_m
