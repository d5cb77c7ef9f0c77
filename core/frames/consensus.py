"""The rigid transform between two world frames that most matched places agree on."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.scans.angles import wrapped_deg
from core.scans.rigid import RigidTransform, about_vertical, proper_rotations

_BASELINE_M = 10.0  # least between two places that give a heading: 1 m of error is 6 degrees
_HYPOTHESES = 4000  # of each kind at most
_AT_ONCE = 500  # hypotheses evaluated at once: 500 x 200 x 3 numbers are 2.4 MB
_REFITS = 5
_HEADING_DEG = 30.0  # most between the yaws of a match and of the transform
_SEED = 20_004


@dataclass(frozen=True, eq=False)
class Consensus:
    """A transform and the matches that agree with it.

    Attributes:
        transform: The transform from the frame of the points to that of their matches.
        agrees: `(n,)` which matches are within the tolerance.
        level: Whether the transform rotates about the vertical only.
    """

    transform: RigidTransform
    agrees: BoolArray
    level: bool


def find_consensus(
    points_m: FloatArray,
    matched_m: FloatArray,
    turn_deg: FloatArray | None,
    tolerance_m: float,
    *,
    level: bool = True,
) -> Consensus | None:
    """Return the transform that the most matches agree on, as RANSAC does.

    A hypothesis is made from two matches, or from one and its heading; from three where the
    vertical may differ too. Where there are many, some are drawn with a fixed seed.

    Args:
        points_m: `(n, 3)` positions of the scans by their drive's poses.
        matched_m: `(n, 3)` positions of the same by their matches.
        turn_deg: `(n,)` heading of the match minus that of the scan; `None` where it is unknown.
        tolerance_m: The largest distance between a match and its transformed scan.
        level: Whether the transform rotates about the vertical only.

    Returns:
        The consensus; `None` if there are fewer than three matches or no hypothesis.
    """
    if len(points_m) < 3:
        return None
    rng = np.random.default_rng(_SEED)
    rotations, at_m, to_m = (_of_pairs if level else _of_triples)(
        points_m, matched_m, tolerance_m, rng
    )
    if level and turn_deg is not None:
        rotations = np.concatenate([rotations, about_vertical(np.radians(turn_deg))])
        at_m, to_m = np.concatenate([at_m, points_m]), np.concatenate([to_m, matched_m])
    if not len(rotations):
        return None
    yaw_deg = turn_deg if level else None
    best = np.zeros(len(points_m), np.bool_)
    for start in range(0, len(rotations), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        placed = np.einsum("hij,nhj->hni", rotations[some], points_m[:, None] - at_m[some])
        off_m = np.linalg.norm(placed + to_m[some, None] - matched_m, axis=2)
        agrees = (off_m <= tolerance_m) & _same_yaw(rotations[some], yaw_deg)
        most = agrees[agrees.sum(axis=1).argmax()]
        if most.sum() > best.sum():
            best = most
    found = None
    for _ in range(_REFITS):
        if best.sum() < 3:
            return None
        transform = RigidTransform.fit(points_m[best], matched_m[best], level=level)
        off_m = np.linalg.norm(transform.apply(points_m) - matched_m, axis=1)
        agree = (off_m <= tolerance_m) & _same_yaw(transform.rotation[None], yaw_deg)[0]
        found = Consensus(transform, agree, level)
        if np.array_equal(agree, best):
            break
        best = agree
    return found


def _of_pairs(
    points_m: FloatArray, matched_m: FloatArray, tolerance_m: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rotations about the vertical, and the pair of points that each aligns."""
    first, second = np.triu_indices(len(points_m), 1)
    way, other_way = points_m[second] - points_m[first], matched_m[second] - matched_m[first]
    fits = np.flatnonzero(_same_length(way, other_way, tolerance_m))
    if len(fits) > _HYPOTHESES:
        fits = rng.choice(fits, _HYPOTHESES, replace=False)
    first, second, way, other_way = first[fits], second[fits], way[fits], other_way[fits]
    angle = np.arctan2(other_way[:, 1], other_way[:, 0]) - np.arctan2(way[:, 1], way[:, 0])
    return (
        about_vertical(angle),
        (points_m[first] + points_m[second]) / 2.0,
        (matched_m[first] + matched_m[second]) / 2.0,
    )


def _of_triples(
    points_m: FloatArray, matched_m: FloatArray, tolerance_m: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rotations in space, and the pair of points that each aligns."""
    triples: IntArray = rng.integers(len(points_m), size=(_HYPOTHESES, 3))
    points, others = points_m[triples], matched_m[triples]
    fits = np.ones(len(triples), np.bool_)
    for one, two in combinations(range(3), 2):
        way, other_way = points[:, one] - points[:, two], others[:, one] - others[:, two]
        fits &= _same_length(way, other_way, tolerance_m)
    points, others = points[fits], others[fits]
    at_m, to_m = points.mean(axis=1), others.mean(axis=1)
    product = np.einsum("hki,hkj->hij", others - to_m[:, None], points - at_m[:, None])
    return proper_rotations(product), at_m, to_m


def _same_length(way: FloatArray, other_way: FloatArray, tolerance_m: float) -> BoolArray:
    """Return which `(n, 3)` vectors are long enough, and as long as the other ones."""
    length, other_length = np.linalg.norm(way, axis=1), np.linalg.norm(other_way, axis=1)
    fits = (length > _BASELINE_M) & (np.abs(length - other_length) < 2.0 * tolerance_m)
    return np.asarray(fits)


def _same_yaw(rotations: FloatArray, turn_deg: FloatArray | None) -> BoolArray:
    """Return which matches have the yaw of each rotation, `(h, n)` or `(h, 1)`."""
    if turn_deg is None:
        return np.ones((len(rotations), 1), np.bool_)
    yaw_deg = np.degrees(np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]))
    aside_deg = wrapped_deg(turn_deg - yaw_deg[:, None])
    return np.asarray(np.abs(aside_deg) <= _HEADING_DEG)
