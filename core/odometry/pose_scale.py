"""Whether poses say a longer or shorter way than the scans show.

Pairs of scans a few metres apart agree with poses that are a fifth too far apart within the errors
of both. Over 8 m that is 1.6 m: the returns of two scans fit best after the motion of the right
length, to some 3 %.
"""

import math
from collections.abc import Callable, Iterator

import numpy as np

from core.arrays import FloatArray
from core.errors import InvalidScan
from core.odometry.structure import BETTER_FIT, Structure
from core.scans.rigid import rotation_deg

_PAIRS, _LEAST_PAIRS = 8, 4
_APART_M, _FARTHEST_M, _MOST_DEG = 8.0, 16.0, 20.0  # of a pair by its poses
_MOST_BETWEEN = 30  # scans from one of a pair to the other
_STARTS = 3 * _PAIRS  # of which some stand, turn or are at the end
_RETURNS = 1500  # of the second scan, enough for shares of them

_SCALES = np.geomspace(1.0 / 1.8, 1.8, 49)  # of the way by the poses
_NEAR_ONE = (0.8, 0.9, 1.1, 1.25)
_LEAST_FIT, _CLEAR_FIT = 0.2, 0.08  # of the best scale, and above the median of all of them
_LEAST_LOG = math.log(1.08)  # wheels and matching of scans are better than that
_ALIKE_LOG, _LEAST_SHARE = math.log(1.06), 0.75  # of the clear pairs, around their median


def scale_of_poses(
    poses: FloatArray,
    given: Callable[[int, int], FloatArray],
    structure_m: Callable[[int], FloatArray],
) -> float | None:
    """Return how many times as far as by the scans the sensor moved by the poses.

    `None` if that is once, or if too few pairs of scans show one scale. A few pairs which fit best
    as the poses say end the search.

    Args:
        poses: `(n, 4, 4)` of the scans.
        given: Returns the motion from one scan to another by the poses, `(4, 4)`, level.
        structure_m: Returns the returns of a scan that are compared, in that frame.
    """
    scales: list[float | None] = []  # as which pairs fit best, `None` if none is clearly best
    for first, last in _pairs(poses):
        try:
            scales.append(_scale(structure_m(first), structure_m(last), given(first, last)))
        except InvalidScan:  # left out of maps too, with a note
            continue
        if scales.count(1.0) >= _LEAST_PAIRS - 1 and len(scales) <= _LEAST_PAIRS:
            return None
    clear = np.log([scale for scale in scales if scale is not None])
    if len(clear) < max(_LEAST_PAIRS, len(scales) / 2):
        return None
    middle = float(np.median(clear))
    alike = float((np.abs(clear - middle) <= _ALIKE_LOG).mean())
    if abs(middle) < _LEAST_LOG or alike < _LEAST_SHARE:
        return None
    return round(math.exp(-middle), 2)


def _pairs(poses: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield pairs spread over the drive, every second one first."""
    found = []
    starts = np.unique(np.linspace(0, len(poses), _STARTS, endpoint=False).astype(int))
    for first in starts[: len(poses)]:
        ahead = poses[first + 1 : first + 1 + _MOST_BETWEEN]
        apart_m = np.linalg.norm(ahead[:, :3, 3] - poses[first, :3, 3], axis=1)
        far = np.flatnonzero(apart_m >= _APART_M)
        if not len(far) or apart_m[far[0]] > _FARTHEST_M:
            continue
        last = int(first + 1 + far[0])
        if rotation_deg(poses[first, :3, :3].T @ poses[last, :3, :3]) <= _MOST_DEG:
            found.append((int(first), last))
    at = np.unique(np.linspace(0, len(found) - 1, min(_PAIRS, len(found))).astype(int)).tolist()
    return (found[i] for i in (*at[::2], *at[1::2]))


def _scale(first_m: FloatArray, last_m: FloatArray, given: FloatArray) -> float | None:
    """Return the scale of a motion as which two scans fit best, 1 if none nearby is better."""
    structure = Structure(first_m)
    some_m = last_m[:: max(1, len(last_m) // _RETURNS)]

    def fit(scale: float) -> float:
        motion = given.copy()
        motion[:3, 3] *= scale
        return structure.fit(some_m, motion)

    least = fit(1.0) - BETTER_FIT
    if least >= _LEAST_FIT and all(fit(scale) <= least for scale in _NEAR_ONE):
        return 1.0
    fits = np.array([fit(float(scale)) for scale in _SCALES])
    best = int(np.argmax(fits))
    if not 0 < best < len(fits) - 1 or fits[best] < _LEAST_FIT:
        return None
    return float(_SCALES[best]) if fits[best] >= np.median(fits) + _CLEAR_FIT else None
