"""The robust fit of the transform that matches agree on, and its spread."""

from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray
from core.frames.consensus import Consensus
from core.frames.matches import Matches, places
from core.scans.angles import wrapped_deg
from core.scans.rigid import RigidTransform

_CAUCHY = 2.385  # 95 % efficient for normal errors
_OF_NORMAL, _OF_RAYLEIGH = 1.4826, 0.8493  # from the median of one, and of two errors, to sigma
_LEAST_M, _LEAST_DEG = 0.05, 0.1  # of a match: images have cells of 4 m and 6 degrees
_ROUNDS = 20
_STILL_M = 1e-4


@dataclass(frozen=True, eq=False)
class FrameFit:
    """The transform from a drive's poses to the frame of the drives that it matches.

    Attributes:
        transform: The transform.
        matches: The matches that it was fitted to.
        spread_m: Standard deviation of a match in x and y, each.
        centre_m: `(3,)` the middle of the matches, in the frame of the others.
        error_m: Standard deviation of the position there, x and y together.
        error_deg: Standard deviation of the heading; of a tilted transform, of the rotation about
            the axis that is known least.
    """

    transform: RigidTransform
    matches: Matches
    spread_m: float
    centre_m: FloatArray
    error_m: float
    error_deg: float

    @property
    def shift_m(self) -> float:
        """How far it moves the middle of the matches."""
        own_m = (self.centre_m - self.transform.translation_m) @ self.transform.rotation
        return float(np.linalg.norm(self.centre_m - own_m))


def fit_frame(consensus: Consensus, matches: Matches) -> FrameFit:
    """Return the fit to the matches of a consensus: least squares, reweighted as Cauchy's errors.

    Positions of the matches are fitted, with their headings where these are known, or, of a tilted
    transform, with the verticals of their poses; each has the spread that is found. Errors count
    one match of each place.

    Args:
        consensus: The start; where its vertical is tilted, so is that of the result.
        matches: The matches that agree with it, at least three.
    """
    points_m, matched_m = matches.points_m, matches.matched_m
    level = consensus.level
    turn_deg = matches.turn_deg if level else None
    verticals = None if level else (matches.vertical, matches.matched_vertical)
    transform = consensus.transform
    for _ in range(_ROUNDS):
        off_m = np.linalg.norm((transform.apply(points_m) - matched_m)[:, :2], axis=1)
        weights, spread_m = cauchy_weights(off_m, _LEAST_M)
        lever_m = 0.0
        if turn_deg is not None:
            aside_deg = np.abs(wrapped_deg(turn_deg - transform.yaw_deg))
            spread_deg = max(_LEAST_DEG, _OF_NORMAL * float(np.median(aside_deg)))
            lever_m = spread_m / np.radians(spread_deg)
        elif verticals is not None:
            cosine = np.sum(verticals[0] @ transform.rotation.T * verticals[1], axis=1)
            aside_deg = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
            spread_deg = max(_LEAST_DEG, _OF_RAYLEIGH * float(np.median(aside_deg)))
            lever_m = spread_m / np.radians(spread_deg)
        before = transform
        transform = RigidTransform.fit(
            points_m,
            matched_m,
            level=level,
            weights=weights,
            turn_deg=turn_deg,
            verticals=verticals,
            lever_m=lever_m,
        )
        moved_m = np.linalg.norm(transform.apply(points_m) - before.apply(points_m), axis=1)
        if moved_m.max() < _STILL_M:
            break
    centre_m = transform.apply((weights[:, None] * points_m).sum(axis=0)[None] / weights.sum())[0]
    apart = places(points_m, matched_m)
    if level:
        arms_m = np.linalg.norm((matched_m - centre_m)[:, :2], axis=1)
        arm_m = np.sqrt(np.average(arms_m**2, weights=weights) + lever_m**2)
    else:
        vectors_m = np.stack([matched_m - centre_m, lever_m * matches.matched_vertical])
        arm_m = _least_arm_m(vectors_m, weights)
    return FrameFit(
        transform,
        matches,
        spread_m,
        centre_m,
        error_m=spread_m * np.sqrt(2.0 / apart),
        error_deg=float(min(180.0, np.degrees(spread_m / (max(arm_m, 0.1) * np.sqrt(apart))))),
    )


def cauchy_weights(off_m: FloatArray, least_m: float) -> tuple[FloatArray, float]:
    """Return the weights of pairs that are so far apart, as of Cauchy's errors, and their spread.

    Args:
        off_m: `(n,)` in x and y.
        least_m: Least spread, the standard deviation of a match in x and y, each.
    """
    spread_m = max(least_m, _OF_RAYLEIGH * float(np.median(off_m)))
    return 1.0 / (1.0 + (off_m / (_CAUCHY * spread_m)) ** 2), spread_m


def _least_arm_m(vectors_m: FloatArray, weights: FloatArray) -> float:
    """Return the root mean square distance of `(k, n, 3)` vectors from the axis nearest to them."""
    squares = np.einsum("kni,knj,n->ij", vectors_m, vectors_m, weights / weights.sum())
    return float(np.sqrt(np.linalg.eigvalsh(squares)[:2].sum()))


def agreeing(transform: RigidTransform, matches: Matches, tolerance_m: float) -> BoolArray:
    """Return which matches are within the tolerance of a transform, `(n,)`."""
    off_m = np.linalg.norm(transform.apply(matches.points_m) - matches.matched_m, axis=1)
    return np.asarray(off_m <= tolerance_m)
