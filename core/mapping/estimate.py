"""The pose of a query between the scans of a map and between their virtual viewpoints.

What a scan between two places is like is about the mean of what it is like at both, weighted by how
near each is. Such means are computed on a lattice along the path and across it, and the estimate is
the mean of its places, each as likely as the query is there: for noise in a signature of d numbers,
of unknown strength, the likelihood is that of the part of the query that the mean does not explain,
(1 - cos^2)^(-d / 2). Beyond the outermost viewpoints the change up to them continues.

A query is nearer to such a mean than to the nearest rendering, at its own place by more than at one
that is alike by chance: distances to means separate the places of many maps better.

Measurements: docs/reference/position-measurements.md; decisions 32 and 35.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray, frozen
from core.encodings.search import Search, Viewpoints
from core.scans.angles import wrapped_deg
from core.scans.displacement import left_of_m, places_beside_m, pose_beside
from core.scans.pose import Pose
from core.scans.trajectory import Trajectory

_SAME_PLACE_M = 10.0  # after an interruption a drive continues elsewhere
_STEPS_ALONG, _STEPS_ACROSS = 8, 4  # of the lattice, between two scans and between two viewpoints
_MOST_STEPS = 1.5  # of heading: the best rendering's is within a few degrees
_ROUNDS = 2  # of place and heading in turn; more change nothing
_LEAST_LEFT = 1e-9  # of the query's energy; an equal scan leaves only rounding


@dataclass(frozen=True)
class Estimate:
    """An estimate relative to a scan of the map.

    Attributes:
        relative_yaw_deg: The query's relative yaw, counter-clockwise, -180..180; `None` if it was
            not known.
        lateral_m: Offset of the query to the left of the scan; `None` in an encoding without
            virtual viewpoints.
        pose: The query's pose, in the heading of the scan if its yaw was not known; `None` where
            the scan's is unknown.
    """

    relative_yaw_deg: float | None = None
    lateral_m: float | None = None
    pose: Pose | None = None


def estimate(
    search: Search,
    trajectory: Trajectory,
    row: int,
    yaw_deg: float | None,
    among: BoolArray | None = None,
) -> Estimate:
    """Estimate the pose of a query near a scan that it matches.

    A search that compares images knows it from these.

    Args:
        search: The query's search.
        trajectory: The map's trajectory.
        row: The scan's.
        yaw_deg: Relative yaw of the query to it, `None` where the encoding does not give it.
        among: `(K,)` which scans may be used, `row` one of them; all without it.
    """
    poses, known = trajectory.poses, bool(trajectory.known[row])
    placed = search.displacement(row)
    if placed is not None:
        ahead_m, beside_m, turned_deg = placed
        placed_pose = pose_beside(poses[row], beside_m, turned_deg, ahead_m)
        return Estimate(turned_deg, beside_m, Pose.from_row(placed_pose))
    around = _Around.of(search, trajectory, row, yaw_deg, among)
    if around is None:
        return Estimate()
    lattice = around.lattice
    step, likely = around.fitted()
    if yaw_deg is not None:
        yaw_deg = wrapped_deg(yaw_deg + step * around.seen.step_deg)
    if not known:
        return Estimate(yaw_deg, float(likely @ lattice.lateral_m), None)
    on_line_m, left_m = places_beside_m(poses[around.rows], np.array([0.0, 1.0])).transpose(1, 0, 2)
    pose = pose_beside(poses[row], 0.0, yaw_deg or 0.0)
    pose[:3] = (likely @ lattice.along) @ on_line_m
    pose[:3] += ((likely * lattice.lateral_m) @ lattice.along) @ (left_m - on_line_m)
    return Estimate(yaw_deg, left_of_m(poses[row], pose), Pose.from_row(pose))


def share_left(search: Search, trajectory: Trajectory, row: int, yaw_deg: float | None) -> float:
    """Return what of a query's distance to a scan is left between the scans and viewpoints.

    It is the distance, 1 - cos, to the nearest mean of the lattice, divided by that to the nearest
    rendering of the scan. Means beyond the outermost viewpoints are left out: they are like other
    places too.

    Args:
        search: The query's search.
        trajectory: The map's trajectory.
        row: The scan's.
        yaw_deg: Relative yaw of the query to it, `None` where the encoding does not give it.

    Returns:
        Above 0 and at most 1, which it is in an encoding without virtual viewpoints.
    """
    around = _Around.of(search, trajectory, row, yaw_deg, None)
    if around is None:
        return 1.0
    step, _ = around.fitted()
    lattice = around.lattice
    seen_m = around.seen.lateral_m
    within = (lattice.lateral_m >= seen_m.min()) & (lattice.lateral_m <= seen_m.max())
    between = 1.0 - float(around.vectors.cosines(lattice.weights[within], step).max())
    here = around.rows == row
    nearest = 1.0 - float(around.vectors.with_query[1].reshape(len(here), -1)[here].max())
    return (max(between, 0.0) + _LEAST_LEFT) / (max(nearest, between, 0.0) + _LEAST_LEFT)


@dataclass(frozen=True, eq=False)
class _Around:
    """A query and the renderings of a scan and those beside it.

    Attributes:
        rows: `(n,)` of the scans, rising.
        seen: The scans' renderings.
        lattice: The lattice between them.
        vectors: Inner products.
    """

    rows: IntArray
    seen: Viewpoints
    lattice: "_Lattice"
    vectors: "_Vectors"

    @classmethod
    def of(
        cls,
        search: Search,
        trajectory: Trajectory,
        row: int,
        yaw_deg: float | None,
        among: BoolArray | None,
    ) -> "_Around | None":
        """Return what `estimate` compares, `None` without virtual viewpoints."""
        known = bool(trajectory.known[row])
        rows = _rows_beside(trajectory, row, among) if known else np.array([row])
        # Poses bring the scans into one heading.
        turn_deg = np.zeros(1)
        if known:
            turn_deg = trajectory.headings_deg[rows] - trajectory.headings_deg[row]
        seen = search.viewpoints(rows, (yaw_deg or 0.0) - turn_deg)
        if seen is None:
            return None
        return cls(
            rows, seen, _lattice(len(rows), tuple(seen.lateral_m.tolist())), _Vectors.of(seen)
        )

    def fitted(self) -> tuple[float, FloatArray]:
        """Return the heading, in steps from the middle one, and how likely each place is."""
        step = 0.0
        for _ in range(_ROUNDS):
            cosines = self.vectors.cosines(self.lattice.weights, step)
            likely = _likelihood(cosines, len(self.seen.query))
            step = _best_step(self.vectors.cosines_of_headings(likely @ self.lattice.weights))
        return step, likely


def _rows_beside(trajectory: Trajectory, row: int, among: BoolArray | None) -> IntArray:
    """Return `row` and the rows before and after it in its drive that were recorded near it."""
    if among is None:
        rows = np.arange(max(0, row - 1), min(row + 2, len(trajectory)))
    else:
        some = np.flatnonzero(among)
        at = int(np.searchsorted(some, row))
        rows = some[max(0, at - 1) : at + 2]
    away_m = trajectory.poses[rows, :3] - trajectory.poses[row, :3]
    near = (away_m * away_m).sum(axis=1) <= _SAME_PLACE_M**2  # an unknown one is NaN and not near
    near &= trajectory.drive_of_scan[rows] == trajectory.drive_of_scan[row]
    return np.asarray(rows[near])


@dataclass(frozen=True, eq=False)
class _Lattice:
    """The places of a lattice, as means of the renderings of some scans.

    Attributes:
        weights: `(p, n D)` of each rendering at each place.
        along: `(p, n)` of each scan.
        lateral_m: `(p,)` how far to the left of the path the places are.
    """

    weights: FloatArray
    along: FloatArray
    lateral_m: FloatArray


@lru_cache(maxsize=8)
def _lattice(scans: int, offsets_m: tuple[float, ...]) -> _Lattice:
    """Return the lattice along some scans and across their viewpoints."""
    along = _between(scans, _STEPS_ALONG)
    across, lateral_m = _across(offsets_m)
    return _Lattice(
        frozen(np.kron(along, across), np.float64),
        frozen(np.repeat(along, len(across), axis=0), np.float64),
        frozen(np.tile(lateral_m, len(along)), np.float64),
    )


def _across(offsets_m: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Return the weights of viewpoints at each place of the lattice across the path.

    It continues as far beyond the outermost ones as these are from the one on the line, by the mean
    of the changes from that one and from the one before the outermost.

    Returns:
        `(c, D)` weights and `(c,)` how far to the left the places are.
    """
    offset_m, viewpoints = np.array(offsets_m), np.eye(len(offsets_m))
    line = int(np.abs(offset_m).argmin())
    weights = [_between(len(offset_m), _STEPS_ACROSS)]
    places_m = [weights[0] @ offset_m]
    steps = line * _STEPS_ACROSS
    ends = (0, min(1, line)), (-1, max(-2, line - len(offset_m)))
    within = places_m[0][1 : steps + 1], places_m[0][steps:-1]
    for (end, before), within_m in zip(ends, within, strict=True):
        places_m.append(2.0 * offset_m[end] - within_m)
        beyond = [
            viewpoints[end]
            + np.outer(
                (offset_m[end] - within_m) / (offset_m[end] - offset_m[beside]),
                viewpoints[end] - viewpoints[beside],
            )
            for beside in (line, before)
        ]
        weights.append(np.mean(beyond, axis=0))
    return np.concatenate(weights), np.concatenate(places_m)


def _between(places: int, steps: int) -> FloatArray:
    """Return the weights of some places at each of `steps` steps from one to the next.

    Examples:
        >>> _between(2, 2).tolist()
        [[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]
    """
    at = np.linspace(0.0, places - 1.0, steps * (places - 1) + 1)
    return np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(places)))


@dataclass(frozen=True, eq=False)
class _Vectors:
    """Inner products of a query and renderings, of length 1 in the middle heading.

    With them the cosine of a mean of renderings needs only its weights: these are a fifth as many
    numbers as a rendering has.

    Attributes:
        of_each: `(3, m, 3, m)` of all renderings in all headings.
        with_query: `(3, m)`.
    """

    of_each: FloatArray
    with_query: FloatArray

    @classmethod
    def of(cls, seen: Viewpoints) -> "_Vectors":
        """Return the products of what is seen of some scans."""
        vectors = seen.renderings.reshape(3, -1, len(seen.query))
        length = np.sqrt(np.square(vectors[1]).sum(axis=-1, keepdims=True))
        units = vectors / np.where(length > 0.0, length, 1.0)
        query = seen.query / (math.sqrt(seen.query @ seen.query) or 1.0)
        flat = units.reshape(-1, len(query))
        shape = units.shape[:2]
        return cls((flat @ flat.T).reshape(*shape, *shape), (flat @ query).reshape(shape))

    def cosines(self, weights: FloatArray, step: float) -> FloatArray:
        """Return the cosines of means with the query, `(p,)`.

        Args:
            weights: `(p, m)` of each rendering.
            step: Heading of the renderings, in steps from the middle one of three, by a parabola.
        """
        if step == 0.0:
            of_each, with_query = self.of_each[1, :, 1], self.with_query[1]
        else:
            before, after = step * (step - 1.0) / 2.0, step * (step + 1.0) / 2.0
            of_heading = np.array([before, 1.0 - step * step, after])
            # Products of matrices: `tensordot` takes longer to arrange them than they take.
            by_first = of_heading @ self.of_each.reshape(3, -1)
            of_each = of_heading @ by_first.reshape(self.of_each.shape[1:])
            with_query = of_heading @ self.with_query
        squared = np.einsum("px,px->p", weights @ of_each, weights)
        return _divided(weights @ with_query, squared)

    def cosines_of_headings(self, weights: FloatArray) -> FloatArray:
        """Return the cosine of one mean in each of three headings with the query, `(3,)`.

        Args:
            weights: `(m,)` of each rendering.
        """
        squared = np.einsum("hxhy,x,y->h", self.of_each, weights, weights)
        return _divided(self.with_query @ weights, squared)


def _divided(products: FloatArray, squared_lengths: FloatArray) -> FloatArray:
    positive = squared_lengths > 0.0
    return products / np.sqrt(np.where(positive, squared_lengths, 1.0))


def _likelihood(cosines: FloatArray, numbers: int) -> FloatArray:
    """Return how likely a query of so many numbers is at each place, `(p,)`; the sum is 1."""
    left = np.maximum(1.0 - np.maximum(cosines, 0.0) ** 2, _LEAST_LEFT)
    likely = (left.min() / left) ** (numbers / 2.0)
    return np.asarray(likely / likely.sum())


def _best_step(cosine: FloatArray) -> float:
    """Return where the parabola through three headings is highest, in steps from the middle one."""
    before, at, after = cosine.tolist()
    curvature = 2.0 * at - before - after
    if curvature <= 0.0:
        return 0.0
    step: float = 0.5 * (after - before) / curvature
    return min(max(step, -_MOST_STEPS), _MOST_STEPS)
